"""Names of derivatives."""


def derivative_name(signal: str, by: str) -> str:
    """gen.w, gen.J -> d(gen.w)/d(gen.J)."""
    return f"d({signal})/d({by})"
