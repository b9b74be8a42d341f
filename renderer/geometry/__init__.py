"""Ray and triangle: watertight intersection, the tree, closest and any hit."""
