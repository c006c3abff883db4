"""The laboratory in JupyterLab and under voila: live, and the last picture is a solution.

One server and one browser for both: voila is an extension of JupyterLab's server.
"""

import json
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from importlib.util import find_spec

import pytest
from browser import Browser, chromium

from ngepc.pictures.views import viewer_installed

INSTALLED = all(map(find_spec, ("jupyterlab", "anywidget")))
pytestmark = [
    pytest.mark.notebooks,
    pytest.mark.skipif(not INSTALLED, reason="they come with the extra notebook"),
    pytest.mark.skipif(chromium() is None, reason="needs Chromium"),
    pytest.mark.skipif(not viewer_installed(), reason="needs the offline viewer"),
]

CODE = """from ngepc import lab, lshape_problem
from ngepc.geometries import lshape
lab(lshape_problem(lshape.paper_mesh(113)), load=(0, 12), gap=(0, 0.2))"""
LAB = """import sys
sys.modules["rfc3987_syntax"] = None
from jupyterlab.labapp import main
raise SystemExit(main())
"""
"""``python -m jupyterlab`` without a grammar of addresses that takes seconds to read."""
OPTIONS = {
    "ServerApp.ip": "127.0.0.1",
    "IdentityProvider.token": "",
    "ServerApp.allow_root": "True",
    "LabApp.expose_app_in_browser": "True",
}
STATE = "document.querySelector('.ngepc-lab').state"
OPENED = "window.jupyterapp && document.querySelector('.jp-Notebook .jp-Cell')"
READY = "jupyterapp.shell.currentWidget?.sessionContext?.session?.kernel?.status"


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """A notebook with one cell, the laboratory."""
    cell = {"cell_type": "code", "execution_count": None, "id": "a", "metadata": {}}
    cell |= {"outputs": [], "source": CODE}
    kernel = {"kernelspec": {"display_name": "Python 3", "name": "python3"}}
    book = {"cells": [cell], "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}
    path = tmp_path_factory.mktemp("book") / "page.ipynb"
    path.write_text(json.dumps(book))
    return path


@contextmanager
def serving(arguments, log):
    """A server of JupyterLab, from the moment that it says its address."""
    with log.open("w") as out:
        command = [sys.executable, "-c", LAB, "--no-browser", *arguments]
        server = subprocess.Popen(command, stdout=out, stderr=out)
    end = time.monotonic() + 120
    while "is running at" not in log.read_text() and time.monotonic() < end:
        time.sleep(0.5)
    yield
    server.terminate()
    try:
        server.wait(20)
    except subprocess.TimeoutExpired:
        server.kill()
        server.wait()


@pytest.fixture(scope="module")
def here(book):
    """The address of a server in the folder of the notebook."""
    port = free_port()
    given = OPTIONS | {"ServerApp.port": port, "ServerApp.root_dir": book.parent}
    flags = [f"--{name}={value}" for name, value in given.items()]
    with serving(flags, book.with_name("log")):
        yield f"http://127.0.0.1:{port}"


@pytest.fixture(scope="module")
def tab():
    """One browser; each visit opens a new tab."""
    with Browser(800, 600) as browser:
        yield browser


def drag_and_check(tab, seen, here):
    """Drag the load: frames meanwhile, the last one a solve; no error, nothing from elsewhere."""
    requests = len(seen.requests)
    errors = list(seen.errors)
    tab.evaluate("document.querySelector('.ngepc-lab').scrollIntoView(); 1")
    tab.settle()
    tab.drag(".ngepc-lab input[name=load]", (10 / 12, 0.3), 20)
    while_dragging = tab.evaluate(f"{STATE}.frames")
    tab.wait_for(f"!{STATE}.busy && {STATE}.wanted === null", 60)
    drawn = tab.evaluate(f"{STATE}.drawn")
    load = tab.evaluate("document.querySelector('.ngepc-lab input[name=load]').exact")
    assert while_dragging >= 3
    assert drawn["exact"]
    assert drawn["values"]["load"] == load
    assert seen.errors == errors
    beyond = [r for r in seen.requests[requests:] if not r.startswith(here)]
    assert [r for r in beyond if r.startswith("http")] == []


def test_the_laboratory_is_live_in_jupyterlab(here, tab):
    seen = tab.visit(f"{here}/lab/tree/page.ipynb?reset")
    tab.wait_for(f"!!({OPENED})", 120)
    tab.wait_for(f"{READY} === 'idle'", 120)
    tab.evaluate("jupyterapp.commands.execute('notebook:run-all-cells'); 1")
    tab.wait_for("!!document.querySelector('.ngepc-lab')", 120)
    drag_and_check(tab, seen, here)
    assert seen.errors == []
    beyond = [r for r in seen.requests if not r.startswith(here)]
    assert [r for r in beyond if r.startswith("http")] == []


def test_the_laboratory_is_live_under_voila(here, tab):
    pytest.importorskip("voila", reason="pip install voila")
    seen = tab.visit(f"{here}/voila/render/page.ipynb")
    tab.wait_for("!!document.querySelector('.ngepc-lab input[name=load]')", 120)
    drag_and_check(tab, seen, here)  # voila's own page asks the network for a script
