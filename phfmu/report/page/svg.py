"""Elements of diagrams in SVG: text, heads of arrows, widths of lines by their energy, colours."""

from html import escape

#: colours of what joins members, and of what comes from outside or ends there
LINE, OUTSIDE = "#0072B2", "#009E73"


def width_of(energy: float, largest: float, widest: float) -> float:
    """Pixels of a line."""
    return max(widest * abs(energy) / largest, 1.0)


def head(x: float, y: float, angle: float, width: float, colour: str) -> str:
    """The head of an arrow on a line of this width; `angle`: degrees, clockwise from the right."""
    size = max(5.0, 0.8 * width)
    points = f"{-size:.1f},{-size:.1f} {size:.1f},0 {-size:.1f},{size:.1f}"
    return f'<polygon points="{points}" transform="translate({x:.1f},{y:.1f}) rotate({angle:.4g})" fill="{colour}"/>'


def text(x: float, y: float, words: str, anchor: str, more: str = "") -> str:
    """Text with a white edge, so that lines below it do not cross it out."""
    halo = 'stroke="white" stroke-width="3" paint-order="stroke" stroke-linejoin="round"'
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {halo} {more}>{escape(words)}</text>'


def picture(width: float, height: float, least: float, size: int, parts: str) -> str:
    """The element of a diagram; `least`: pixels below which a page scrolls it, `size`: of its letters."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        f'width="{width:.0f}" height="{height:.0f}" role="img" '
        f'style="min-width:{least:.0f}px" '
        f'font-family="sans-serif" font-size="{size}"><title>one-line diagram</title>{parts}</svg>'
    )
