"""The studio's page in a browser, opened and ready."""

from ves_gym.report.studio import render_studio

_READY = (
    "document.getElementById('truth').dataset.done === 'yes' && vesStudio.chart.image !== null"
)


def open_page(browser, data, folder):
    """Write the page, load it, and return its address."""
    file = folder / "studio.html"
    file.write_text(render_studio(data))
    browser.open(file.as_uri())
    assert browser.errors == []
    return file.as_uri()


def until(browser, condition):
    """Wait until an expression is true in the page."""
    look = f"const look = () => ({condition}) ? go(true) : setTimeout(look, 20); look();"
    assert browser.do(f"new Promise((go) => {{ {look} }})")


def ready(browser):
    """Wait until the page has compared its energies and drawn its map."""
    until(browser, _READY)
