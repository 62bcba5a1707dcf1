"""What serves every room and knows none of them: files, locks, threads, progress, memory, optional libraries."""
