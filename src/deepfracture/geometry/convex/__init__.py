"""Convex polytopes: hulls, clipping, decomposition, and parting those of neighbours."""
