"""From a GS-SDF to fragments: which voxel belongs to which."""
