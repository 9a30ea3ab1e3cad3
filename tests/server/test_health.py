"""What restarts a server and wakes somebody: its own word on whether it is ready. And the password it starts with."""

from __future__ import annotations

import pytest
from sqlalchemy import make_url

from lidarcodec.commands.certs.certificates import Authority
from lidarcodec.commands.health import run as health
from lidarcodec.commands.server_extra import server_config
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec_server.store.passwords import with_password
from tests.command_line import run_here, start
from tests.server.live import running
from tests.server.test_metrics import value
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

URL = "postgresql://lidarcodec@database/lidarcodec"


def test_a_server_is_well_until_its_database_is_away(tmp_path, monkeypatch, capsys):
    with running(tmp_path) as server:
        health(None, server.url)
        assert capsys.readouterr().out == "well\n"
        assert value(server.app.state.service.metrics.text().decode(), "lidarcodec_ready", part="store") == 1
        server.app.state.service.store.close()
        (tmp_path / "server.db").unlink()
        (tmp_path / "server.db").mkdir()
        with pytest.raises(SourceError, match="is not ready: store"):
            health(None, server.url)
        text = server.app.state.service.metrics.text().decode()
        assert value(text, "lidarcodec_ready", part="store") == 0
        assert value(text, "lidarcodec_ready", part="zenoh") == 1


def test_a_server_with_a_certificate_for_another_name_is_asked_on_loopback(tmp_path):
    issued = Authority.open(tmp_path).issue("server", ("server.example",), 1)
    (tmp_path / "cert.pem").write_bytes(issued.certificate)
    (tmp_path / "key.pem").write_bytes(issued.key)
    secured = ("--tls-certificate", tmp_path / "cert.pem", "--tls-key", tmp_path / "key.pem")
    database = f"sqlite:///{tmp_path / 'server.db'}"
    listen = f"tcp/127.0.0.1:{free_port()}"
    with start("serve", "--port", 0, "--database-url", database, "--listen", listen, *secured) as server:
        try:
            url = server.stdout.readline().split()[2]
            assert url.startswith("https://127.0.0.1:")
            assert eventually(lambda: run_here("health", "--url", url).returncode == 0, 60)
            with pytest.raises(SourceError, match="does not answer"):
                health(None, url.replace("https:", "http:"))
        finally:
            server.kill()


@pytest.mark.parametrize("password", ["plain", "p@ss:w/rd %41?", "  spaces  ", "ünïcode"])
def test_a_password_from_a_file_is_used_as_it_is(tmp_path, password):
    file = tmp_path / "password"
    file.write_text(f"{password}\nwhatever else\n")
    assert make_url(with_password(URL, file)).password == password
    config = server_config(database_url=URL, database_password_file=file)
    assert make_url(config.database_url).password == password


@pytest.mark.parametrize(
    ("content", "url"),
    [
        (b"", URL),
        (b"\nsecond line", URL),
        (b"\xff\xfe", URL),
        (None, URL),
        (b"secret", None),
        (b"secret", "sqlite:///server.db"),
        (b"secret", "postgresql://lidarcodec:other@database/lidarcodec"),
        (b"secret", "nothing"),
    ],
)
def test_what_cannot_be_meant_is_refused_and_no_password_is_told(tmp_path, content, url):
    file = tmp_path / "password"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(SettingsError) as refused:
        with_password(url, file)
    assert "secret" not in str(refused.value)
    assert "other" not in str(refused.value)
