"""Mesh files of other programs, collected in one folder for the campaign ``foreign``.

``PYTHONPATH=tests python -m campaigns.beds FOLDER [meshio-5.3.5.tar.gz]``: the decks of Debian's
package calculix-ccx-test, the geometries of gmsh's tutorials and examples meshed in orders 1 and 2
and written in formats 2.2 and 4.1 (``pip install gmsh``), and the test meshes of meshio's source
distribution (``pip download --no-deps --no-binary meshio meshio``).
"""

import gzip
import os
import shutil
import signal
import sys
import tarfile
from pathlib import Path

try:
    import gmsh
except ImportError:  # then there are no tutorials
    gmsh = None

DECKS = Path("/usr/share/doc/calculix-ccx-test/examples/test")
TUTORIALS = Path(sys.prefix) / "share/doc/gmsh"
SECONDS = 25  # for one geometry
MOST = 200_000  # elements


def decks(folder):
    """The decks of CalculiX, unpacked."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in DECKS.glob("*.inp"):
        shutil.copy(path, folder / path.name)
    for path in DECKS.glob("*.inp.gz"):
        (folder / path.stem).write_bytes(gzip.decompress(path.read_bytes()))


def meshes_of_meshio(folder, archive):
    """The test meshes of meshio."""
    folder.mkdir(parents=True, exist_ok=True)
    with tarfile.open(archive) as files:
        for member in files:
            if "/tests/meshes/" in member.name and member.isfile():
                files.extract(member, folder, filter="data")


def tutorials(folder):
    """gmsh's own geometries, each meshed in a process with a time limit in seconds."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(TUTORIALS.rglob("*.geo")):
        for order in (1, 2):
            for version in (2.2, 4.1):
                out = folder / f"{path.stem}_o{order}_{version}.msh"
                if not out.exists():
                    child = os.fork()
                    if child == 0:
                        mesh(path, order, version, out)
                    os.waitpid(child, 0)


def mesh(path, order, version, out):
    """Mesh a geometry and leave the process."""
    try:
        signal.alarm(SECONDS)
        os.chdir(path.parent)
        gmsh.initialize()
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        gmsh.option.setNumber("Mesh.ElementOrder", order)
        dimension = gmsh.model.getDimension()
        gmsh.model.mesh.generate(dimension)
        if order == 2:
            gmsh.model.mesh.setOrder(2)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        if sum(map(len, gmsh.model.mesh.getElements(dimension)[1])) < MOST:
            gmsh.write(str(out))
    except Exception as error:  # gmsh cannot mesh this geometry: skip it
        print(f"{path.name}: {error}")
    finally:
        os._exit(0)


if __name__ == "__main__":
    bed = Path(sys.argv[1])
    decks(bed / "CalculiX")
    if len(sys.argv) > 2:
        meshes_of_meshio(bed / "meshio", sys.argv[2])
    if gmsh is not None:
        tutorials(bed / "gmsh")
