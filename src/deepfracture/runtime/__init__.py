"""Services for every room: atomic files, locks, threads, progress, memory, optional libraries."""
