"""Members stepped apart beside the composed model: cost, what joins them, threads."""
