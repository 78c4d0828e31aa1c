"""A page opened in Chromium without a window: `python browser.py PAGE PICTURE [FRAGMENT]`; prints what it found as JSON.

A process of its own: Qt's loop and its crashes stay out of the tests.
"""

from __future__ import annotations

import json
import os
import sys

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
os.environ.setdefault(
    "QTWEBENGINE_CHROMIUM_FLAGS", "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
)

from PySide6.QtCore import QTimer, QUrl  # noqa: E402  (the platform comes first)
from PySide6.QtWebEngineCore import QWebEnginePage, QWebEngineUrlRequestInterceptor  # noqa: E402
from PySide6.QtWebEngineWidgets import QWebEngineView  # noqa: E402
from PySide6.QtWidgets import QApplication  # noqa: E402

WIDTH, HEIGHT, PATIENCE = 1300, 1600, 60_000  # px, px, ms
FOUND = """JSON.stringify([document.title, document.body.innerText, document.querySelectorAll('svg').length,
    document.querySelectorAll('.plotly .trace').length,
    Math.max(...[...document.querySelectorAll('.wide svg')].map(s => s.getBoundingClientRect().right), 0)])"""


class Page(QWebEnginePage):
    """Keeps what the scripts of the page complain about."""

    complaints: list[str] = []

    def javaScriptConsoleMessage(self, level: object, message: str, line: int, source: str) -> None:
        self.complaints.append(message)


class Outside(QWebEngineUrlRequestInterceptor):
    """Keeps what a page asks of other places than its own file."""

    asked: list[str] = []

    def interceptRequest(self, info: object) -> None:
        url = info.requestUrl()  # type: ignore[attr-defined]
        if url.scheme() not in ("file", "data", "blob"):
            self.asked.append(url.toString())
            info.block(True)  # type: ignore[attr-defined]


def main(path: str, picture: str, fragment: str = "") -> int:
    app = QApplication(sys.argv[:1])
    view, outside = QWebEngineView(), Outside()
    page = Page(view)
    page.setUrlRequestInterceptor(outside)
    view.setPage(page)
    view.resize(WIDTH, HEIGHT)
    view.show()

    def told(found: str) -> None:
        names = ("title", "text", "drawings", "curves", "right")
        facts = dict(zip(names, json.loads(found), strict=True)) | {
            "complaints": page.complaints,
            "asked": outside.asked,
        }
        view.grab().save(picture)
        print(json.dumps(facts))
        app.quit()

    def loaded(_: bool) -> None:
        page.runJavaScript("document.body.dataset.drawn || ''", 0, drawn)  # scripts draw after the page is there

    def drawn(all_figures: str) -> None:
        if all_figures:
            QTimer.singleShot(500, lambda: page.runJavaScript(FOUND, 0, told))
        else:
            QTimer.singleShot(100, lambda: loaded(True))

    view.loadFinished.connect(loaded)
    address = QUrl.fromLocalFile(os.path.abspath(path))
    address.setFragment(fragment)
    view.load(address)
    QTimer.singleShot(PATIENCE, lambda: app.exit(1))
    return app.exec()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
