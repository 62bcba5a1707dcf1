"""Voxel fields: faces that cracks cut, connected components, and what becomes of components that are too small."""

from deepfracture.voxels.components import connected_components, connected_labels
from deepfracture.voxels.cut_faces import cut_faces
from deepfracture.voxels.small_components import components_of_at_least, merge_graph, merge_small_components

__all__ = [
    "components_of_at_least",
    "connected_components",
    "connected_labels",
    "cut_faces",
    "merge_graph",
    "merge_small_components",
]
