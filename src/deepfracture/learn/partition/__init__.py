"""The project's own network: a code partitions the shape into fragments, one smooth function for each."""
