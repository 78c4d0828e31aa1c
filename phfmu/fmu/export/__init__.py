"""Units written: descriptions, terminals, manifest, sources and the archive."""
