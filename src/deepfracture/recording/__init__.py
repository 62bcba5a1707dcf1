"""What a recording shows, for every exporter and renderer: poses at any frame, surfaces with their materials."""
