"""A run as a picture that moves: poses of shapes from its columns, a page that plays them, an animated image."""
