"""The laboratory in JupyterLab: dragging is live, and the last picture is a solution."""

import json
import socket
import subprocess
import sys
import time

import pytest
from browser import Browser, chromium

from ngepc.pictures.views import viewer_installed

pytest.importorskip("jupyterlab", reason="comes with the extra notebook")
pytest.importorskip("anywidget", reason="comes with the extra notebook")
pytestmark = [
    pytest.mark.notebooks,
    pytest.mark.skipif(chromium() is None, reason="needs Chromium"),
    pytest.mark.skipif(not viewer_installed(), reason="needs the offline viewer"),
]

CODE = """from ngepc import lab, lshape_problem
from ngepc.geometries import lshape
lab(lshape_problem(lshape.paper_mesh(225)), load=(0, 12), gap=(0, 0.2))"""
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


@pytest.fixture
def page(tmp_path):
    """The address of a notebook with one cell in a JupyterLab of its own."""
    cell = {"cell_type": "code", "execution_count": None, "id": "a", "metadata": {}}
    cell |= {"outputs": [], "source": CODE}
    kernel = {"kernelspec": {"display_name": "Python 3", "name": "python3"}}
    book = {"cells": [cell], "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}
    (tmp_path / "page.ipynb").write_text(json.dumps(book))
    port = free_port()
    given = OPTIONS | {"ServerApp.port": port, "ServerApp.root_dir": tmp_path}
    flags = [f"--{name}={value}" for name, value in given.items()]
    command = [sys.executable, "-m", "jupyterlab", "--no-browser", *flags]
    log = tmp_path / "log"
    with log.open("w") as out:
        lab = subprocess.Popen(command, stdout=out, stderr=out)
    end = time.monotonic() + 120
    while "is running at" not in log.read_text() and time.monotonic() < end:
        time.sleep(0.5)
    yield f"http://127.0.0.1:{port}/lab/tree/page.ipynb?reset"
    lab.terminate()
    try:
        lab.wait(20)
    except subprocess.TimeoutExpired:
        lab.kill()
        lab.wait()


def test_the_laboratory_is_live_in_jupyterlab(page):
    with Browser(1300, 900) as tab:
        seen = tab.visit(page)
        tab.wait_for(f"!!({OPENED})", 120)
        tab.wait_for(f"{READY} === 'idle'", 120)
        tab.evaluate("jupyterapp.commands.execute('notebook:run-all-cells'); 1")
        tab.wait_for("!!document.querySelector('.ngepc-lab')", 120)
        tab.evaluate("document.querySelector('.ngepc-lab').scrollIntoView(); 1")
        tab.settle()
        tab.drag(".ngepc-lab input[name=load]", (10 / 12, 0.3), 60)
        while_dragging = tab.evaluate(f"{STATE}.frames")
        tab.wait_for(f"!{STATE}.busy && {STATE}.wanted === null", 60)
        drawn = tab.evaluate(f"{STATE}.drawn")
        load = tab.evaluate(
            "document.querySelector('.ngepc-lab input[name=load]').exact"
        )
        assert while_dragging >= 3
        assert drawn["exact"]
        assert drawn["values"]["load"] == load
        assert seen.errors == []
        here = page.split("/lab/")[0]
        beyond = [r for r in seen.requests if not r.startswith(here)]
        assert [r for r in beyond if r.startswith("http")] == []
