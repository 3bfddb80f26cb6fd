# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The Studio is fetched from a registry as npm's, by hash, whole or not at all."""

from __future__ import annotations

import base64
import hashlib
import http.server
import io
import os
import subprocess
import sys
import tarfile
import threading
from dataclasses import replace
from urllib.parse import urlsplit

import pytest

from cassandra_ros.cli import viewer
from cassandra_ros.errors import DownloadFailed
from cassandra_ros.viewing import studio

MAP = b"\n//# sourceMappingURL=data:application/json;base64,AAAA"


def tarball(files, links=()):
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
        for name, target in links:
            info = tarfile.TarInfo(name)
            info.type, info.linkname = tarfile.SYMTYPE, target
            archive.addfile(info)
    return packed.getvalue()


FILES = {
    "@foxglove/studio-base": tarball(
        {
            "package/assets/index.js": b"start();" + MAP,
            "package/assets/deep/1.wasm": b"\0asm",
            "package/src/index.js": b"not kept",
            "package/package.json": b"{}",
            "package/../../assets/out.js": b"outside",
            "package/assets/../../../out.js": b"outside",
            "/package/assets/absolute.js": b"outside",
        },
        links=[("package/assets/link.js", "/etc/passwd")],
    ),
    "react": tarball({"package/umd/react.production.min.js": b"react", "package/LICENSE": b"MIT"}),
    "react-dom": tarball({"package/umd/react-dom.production.min.js": b"dom"}),
}


def integrity(data):
    return "sha512-" + base64.b64encode(hashlib.sha512(data).digest()).decode()


class Registry(http.server.BaseHTTPRequestHandler):
    """Answers as npm's registry; what the server's ``broken`` holds comes first."""

    def do_GET(self):
        server = self.server
        server.asked.append(self.path)
        name = self.path[1:].split("/-/")[0]
        data = server.broken.pop(0) if server.broken else FILES.get(name)
        if data is None:
            self.send_error(500)
            return
        self.send_response(200)
        self.send_header("Content-Length", str(max(len(data), 100)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *args):
        pass


@pytest.fixture
def registry(monkeypatch, tmp_path):
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Registry)
    server.asked, server.broken = [], []
    thread = threading.Thread(target=server.serve_forever, args=[0.01])
    thread.start()
    known = [replace(p, integrity=integrity(FILES[p.name])) for p in studio.PACKAGES]
    monkeypatch.setattr(studio, "PACKAGES", known)
    monkeypatch.setattr(studio, "_PAUSE_SEC", 0)
    monkeypatch.setenv("npm_config_registry", f"http://127.0.0.1:{server.server_port}/")
    monkeypatch.setenv("npm_config_userconfig", str(tmp_path / "npmrc"))
    monkeypatch.setattr(studio, "MACHINE_FILES", [tmp_path / "machine"])
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    monkeypatch.setenv("CASSANDRA_ROS_STUDIO", str(tmp_path / "home"))
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def files_below(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_it_is_fetched_whole_once_and_only_what_pages_need(registry, tmp_path):
    folder, said = studio.studio_folder(), []
    assert folder == tmp_path / "home" / "1.48.0"
    assert not studio.studio_installed(folder)
    assert studio.install_studio(folder, said.append) is True
    assert studio.studio_installed(folder)
    assert files_below(folder) == {
        "complete.json",
        "@foxglove/studio-base/assets/index.js",
        "@foxglove/studio-base/assets/deep/1.wasm",
        "@foxglove/studio-base/package.json",
        "react/umd/react.production.min.js",
        "react/LICENSE",
        "react-dom/umd/react-dom.production.min.js",
    }
    # Without the map of its sources, two thirds of it, that a browser would read each time.
    assert (folder / "@foxglove/studio-base/assets/index.js").read_bytes() == b"start();\n"
    assert registry.asked == [
        "/@foxglove/studio-base/-/studio-base-1.48.0.tgz",
        "/react/-/react-17.0.2.tgz",
        "/react-dom/-/react-dom-17.0.2.tgz",
    ]
    assert len(said) == 3
    assert studio.install_studio(folder, said.append) is False
    assert len(registry.asked) == 3
    # Nothing is beside it, whatever names the tarball has, and no draft is left.
    assert [path.name for path in folder.parent.iterdir()] == ["1.48.0"]
    # Another version that was known before, or half of one, is replaced.
    (folder / "complete.json").write_text("{}")
    assert studio.install_studio(folder, said.append) is True


def test_what_is_cut_short_or_refused_is_tried_again(registry):
    whole = FILES["@foxglove/studio-base"]
    registry.broken = [None, whole[:50], b"x" * 200]
    said = []
    assert studio.install_studio(studio.studio_folder(), said.append)
    failures = [line for line in said if "failed" in line]
    assert "500" in failures[0]
    assert "hash" in failures[2]
    assert len(failures) == 3


def test_what_npm_did_not_publish_is_not_installed(registry, monkeypatch, tmp_path):
    other = [replace(studio.PACKAGES[0], integrity=integrity(b"other")), *studio.PACKAGES[1:]]
    monkeypatch.setattr(studio, "PACKAGES", other)
    with pytest.raises(DownloadFailed, match="hash is sha512-.*4 times|4 times: its hash"):
        studio.install_studio(studio.studio_folder(), lambda line: None)
    assert not any((tmp_path / "home").iterdir())
    monkeypatch.setenv("npm_config_registry", "file:///etc")
    with pytest.raises(DownloadFailed, match="npm_config_registry"):
        studio.install_studio(studio.studio_folder(), lambda line: None)


def test_the_registry_is_the_one_of_npms_configuration(registry, monkeypatch, tmp_path):
    address = os.environ["npm_config_registry"]
    monkeypatch.delenv("npm_config_registry")
    monkeypatch.setenv("PLACE", address)
    (tmp_path / "machine").write_text("registry=http://127.0.0.1:9/of-the-machine\n")
    (tmp_path / "npmrc").write_text("; ours\nfund = false\nregistry = ${PLACE}\n")
    assert studio.install_studio(studio.studio_folder(), lambda line: None)
    assert len(registry.asked) == len(studio.PACKAGES)
    # A scope's own registry is for its packages alone, and the environment is stronger than files.
    with (tmp_path / "npmrc").open("a") as file:
        file.write('@foxglove:registry="https://scope.invalid/npm/"\n')
    monkeypatch.setenv("NPM_CONFIG_REGISTRY", "http://env.invalid")
    asked = [studio.tarball_address(each.name, each.version) for each in studio.PACKAGES[:2]]
    assert asked == [
        "https://scope.invalid/npm/@foxglove/studio-base/-/studio-base-1.48.0.tgz",
        "http://env.invalid/react/-/react-17.0.2.tgz",
    ]


def test_without_a_configuration_it_is_npms_usual_one(registry, monkeypatch):
    monkeypatch.delenv("npm_config_registry")
    asked = [studio.tarball_address(each.name, each.version) for each in studio.PACKAGES[:2]]
    first, second = map(urlsplit, asked)
    assert first.scheme == second.scheme == "https"
    assert first.netloc == second.netloc != ""
    assert first.path == "/@foxglove/studio-base/-/studio-base-1.48.0.tgz"
    assert second.path == "/react/-/react-17.0.2.tgz"
    monkeypatch.setitem(sys.modules, "packageurl", None)
    with pytest.raises(DownloadFailed, match="names no registry: set npm_config_registry.*pip"):
        studio.install_studio(studio.studio_folder(), lambda line: None)


def test_a_tarball_is_bounded(tmp_path, monkeypatch):
    keep = studio.re.compile(".*")
    monkeypatch.setattr(studio, "_MAX_FILE_BYTES", 4)
    with pytest.raises(DownloadFailed, match="5 bytes"):
        studio.unpack(io.BytesIO(tarball({"package/a": b"12345"})), tmp_path, keep)
    monkeypatch.setattr(studio, "_MAX_FILES", 2)
    many = tarball({f"package/{number}": b"" for number in range(3)})
    with pytest.raises(DownloadFailed, match="over 2 files"):
        studio.unpack(io.BytesIO(many), tmp_path, keep)
    with pytest.raises(DownloadFailed, match="not a tarball"):
        studio.unpack(io.BytesIO(b"nonsense"), tmp_path, keep)


def test_the_command_line_fetches_it_without_a_store(registry, capsys):
    assert viewer.main(["--install-studio"]) == 0
    assert f"Studio 1.48.0 is now in {studio.studio_folder()}" in capsys.readouterr().out
    assert viewer.main(["--install-studio"]) == 0
    assert "Studio 1.48.0 was already in" in capsys.readouterr().out


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(("whose", "reads"), [("its own", True), ("of another session", False)])
def test_only_who_has_a_terminal_for_itself_is_asked(whose, reads, tmp_path):
    """roslaunch hands its terminal on to all nodes, and starts each in a session of its own."""
    controller, terminal = os.openpty()
    program = (
        "import fcntl, sys, termios\n"
        "if sys.argv[1] == 'its own':\n"
        "    fcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
        "from cassandra_ros.cli.confirmation import person_reads\n"
        "print(person_reads())"
    )
    try:
        done = subprocess.run(
            [sys.executable, "-c", program, whose], stdin=terminal, stdout=subprocess.PIPE,
            stderr=terminal, start_new_session=True, text=True, timeout=300,
        )  # fmt: skip
    finally:
        os.close(terminal)
        os.close(controller)
    assert done.stdout == f"{reads}\n"


def test_a_person_is_asked_once_at_the_first_start(registry, capsys, monkeypatch):
    folder = studio.studio_folder()
    monkeypatch.setattr(viewer, "person_reads", lambda: sys.stdin.isatty())
    monkeypatch.setattr("sys.stdin", io.StringIO())
    viewer.offer_studio("viewer", folder)
    assert "--install-studio" in capsys.readouterr().err  # no terminal to ask on
    monkeypatch.setattr("sys.stdin", Terminal("n\n"))
    viewer.offer_studio("viewer", folder)
    assert "[y/N]" in capsys.readouterr().err
    viewer.offer_studio("viewer", folder)
    told = capsys.readouterr().err
    assert "[y/N]" not in told
    assert "--install-studio" in told
    (folder.parent / "declined").unlink()
    registry.broken = [None] * 4
    monkeypatch.setattr("sys.stdin", Terminal("y\n"))
    viewer.offer_studio("viewer", folder)  # the viewer starts nevertheless
    assert "could not be fetched" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", Terminal("y\n"))
    viewer.offer_studio("viewer", folder)
    assert studio.studio_installed(folder)
    capsys.readouterr()
    viewer.offer_studio("viewer", folder)
    assert capsys.readouterr().err == ""
