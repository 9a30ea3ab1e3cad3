"""`lidarcodec certs`: files that nobody else reads, names that cannot be mixed up, and a deployment that can grow."""

import base64
import json
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from lidarcodec.commands.certs import command as certs
from lidarcodec.errors import MissingExtraError, SettingsError, SourceError
from lidarcodec.files.folder_lock import locked
from tests.command_line import run, start
from tests.transport.conftest import free_port
from tests.transport.router import Router

x509 = pytest.importorskip("cryptography.x509")


def make(folder, routers=(), vehicles=(), viewers=(), operators=(), remove=(), auth=None, port=None, installed=None):
    people = {"vehicles": vehicles, "viewers": viewers, "operators": operators, "remove": remove}
    certs.run(folder, routers=routers, **people, auth=auth, port=port, days=90, installed=installed)


def read(path):
    return json.loads(path.read_text().partition("\n")[2])


def tls(path):
    return read(path)["transport"]["link"]["tls"]


def test_secrets_are_readable_by_their_owner_only(tmp_path):
    make(tmp_path, ["a.example"], ["car-7"], ["anna"], ["olga"], auth="password")
    open_to_all = {path.name for path in tmp_path.iterdir() if path.stat().st_mode & 0o077}
    assert open_to_all <= {"ca.pem", "deployment.json"}
    assert {path.name for path in tmp_path.iterdir()} == {
        *("ca.pem", "ca.key", "deployment.json", "users.txt", "router-a.example.json5"),
        *("vehicle-car-7.json5", "viewer-anna.json5", "operator-olga.json5"),
    }
    assert "secret" not in (tmp_path / "deployment.json").read_text()


def test_a_later_call_adds_renews_who_is_named_and_keeps_the_rest(tmp_path):
    make(tmp_path, ["a.example"], ["car-7"], ["anna"])
    car, anna, authority = (tmp_path / name for name in ("vehicle-car-7.json5", "viewer-anna.json5", "ca.pem"))
    before = car.read_bytes(), anna.read_bytes(), authority.read_bytes()
    make(tmp_path, [], ["car-8"], ["anna"])
    assert (car.read_bytes(), authority.read_bytes()) == (before[0], before[2])
    assert anna.read_bytes() != before[1]
    rules = json.dumps(read(tmp_path / "router-a.example.json5")["access_control"])
    assert all(name in rules for name in ("car-7", "car-8", "anna"))
    make(tmp_path, remove=["car-7"])
    assert not car.exists()
    assert "car-7" not in json.dumps(read(tmp_path / "router-a.example.json5")["access_control"])


def test_a_password_stays_until_its_user_is_named_again(tmp_path):
    make(tmp_path, ["a.example"], ["car-7"], ["anna"], auth="password", installed=Path("/etc/lidarcodec"))
    first = (tmp_path / "users.txt").read_text()
    make(tmp_path, [], [], ["ben"])
    assert set(first.splitlines()) < set((tmp_path / "users.txt").read_text().splitlines())
    make(tmp_path, [], [], ["anna"], remove=["ben"])
    users = dict(line.split(":") for line in (tmp_path / "users.txt").read_text().splitlines())
    before = dict(line.split(":") for line in first.splitlines())
    assert set(users) == {"router", "car-7", "anna"}
    assert users["anna"] != before["anna"]
    assert users["router"] == before["router"]
    assert users["anna"] == read(tmp_path / "viewer-anna.json5")["transport"]["auth"]["usrpwd"]["password"]
    router = read(tmp_path / "router-a.example.json5")["transport"]["auth"]["usrpwd"]
    assert router["dictionary_file"] == "/etc/lidarcodec/users.txt"


def test_a_certificate_names_whom_and_where_and_for_how_long(tmp_path):
    make(tmp_path, ["a.example", "10.0.0.5"], ["car-7"])
    for host in ("a.example", "10.0.0.5"):
        pem = base64.b64decode(tls(tmp_path / f"router-{host}.json5")["listen_certificate_base64"])
        certificate = x509.load_pem_x509_certificate(pem)
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        assert host in [str(name.value) for name in names]
        assert certificate.subject.rfc4514_string() == "CN=router"
        assert 89 <= (certificate.not_valid_after_utc - certificate.not_valid_before_utc).days <= 91
    authority = x509.load_pem_x509_certificate((tmp_path / "ca.pem").read_bytes())
    certificate.verify_directly_issued_by(authority)
    assert read(tmp_path / "vehicle-car-7.json5")["connect"]["endpoints"] == [
        "tls/a.example:7447",
        "tls/10.0.0.5:7447",
    ]


def test_only_those_who_listen_have_a_certificate_with_which_they_can(tmp_path):
    """A viewer that is called like a router could take its place: the name is in its certificate."""
    make(tmp_path, ["a.example"], ["car-7"], ["b.example"])
    may_listen = {}
    for name in ("router-a.example", "vehicle-car-7", "viewer-b.example"):
        certificate = x509.load_pem_x509_certificate(
            base64.b64decode(tls(tmp_path / f"{name}.json5")["connect_certificate_base64"])
        )
        uses = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert x509.oid.ExtendedKeyUsageOID.CLIENT_AUTH in uses
        may_listen[name] = x509.oid.ExtendedKeyUsageOID.SERVER_AUTH in uses
    assert may_listen == {"router-a.example": True, "vehicle-car-7": False, "viewer-b.example": False}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"vehicles": ["car-7"]}, "there is nothing to connect to"),
        ({}, "there is nothing to connect to"),
        ({"routers": ["a"], "vehicles": ["x"], "viewers": ["x"]}, "name is already used"),
        ({"routers": ["a"], "viewers": ["router"]}, "name is already used"),
        ({"routers": ["a"], "vehicles": ["playback-1"]}, "are reserved for playbacks"),
        ({"routers": ["a"], "vehicles": ["car 7"]}, "is not a valid name"),
        ({"routers": ["a b"]}, "is not a host"),
        ({"routers": ["::1"]}, "a name that stands for it"),
        ({"vehicles": ["car-7@fe80::1"]}, "a name that stands for it"),
        ({"routers": ["a"], "vehicles": ["car-7@b"]}, "leave out"),
        ({"viewers": ["anna@b"], "routers": ["a"]}, "only a vehicle can have a host"),
        ({"routers": ["a"], "remove": ["nobody"]}, "no such name"),
        ({"routers": ["a"], "auth": "trust"}, "certificate, password or none"),
    ],
)
def test_a_deployment_that_cannot_work_is_refused_and_nothing_is_written(tmp_path, options, said):
    with pytest.raises(SettingsError, match=said):
        make(tmp_path / "d", **options)
    assert not any((tmp_path / "d").iterdir())


def test_what_lies_there_and_is_no_deployment_is_not_written_over(tmp_path):
    make(tmp_path, ["a"], ["car-7"])
    with pytest.raises(SettingsError, match="another folder"):
        make(tmp_path, auth="password")
    (tmp_path / "ca.pem").write_text("no certificate")
    with pytest.raises(SettingsError, match="the certificate authority"):
        make(tmp_path, [], ["car-8"])
    (tmp_path / "deployment.json").write_text('{"auth": "certificate"}')
    with pytest.raises(SettingsError, match="port"):
        make(tmp_path, [], ["car-8"])


def test_without_the_package_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cryptography", None)
    with pytest.raises(MissingExtraError, match=r"lidarcodec\[server\]"):
        make(tmp_path, ["a"], ["car-7"])


def test_a_stream_goes_through_a_secured_router_with_nothing_but_the_two_files(tmp_path):
    port = free_port()
    done = run("certs", tmp_path, "--router", "localhost", "--vehicle", "car-7", "--viewer", "anna", "--port", port)
    assert done.returncode == 0, done.stderr
    assert str(tmp_path / "viewer-anna.json5") in done.stdout
    wrong = run("publish", "sim:road", "--vehicle", "car-8", "--zenoh-config", tmp_path / "vehicle-car-7.json5")
    assert wrong.returncode == 2
    assert "is the configuration of vehicle car-7, which is not allowed to publish as car-8" in wrong.stderr
    router = Router(config=str(tmp_path / "router-localhost.json5"), listen=f"tls/localhost:{port}")
    car = start("publish", "sim:road?sensor=vlp16", "--zenoh-config", tmp_path / "vehicle-car-7.json5")
    try:
        words = ("car-7/lidar", "--frames", "5", "--zenoh-config", tmp_path / "viewer-anna.json5", "--json")
        seen = run("subscribe", *words)
        assert seen.returncode == 0, seen.stderr
        assert json.loads(seen.stdout)["frames"] >= 5
        assert json.loads(seen.stdout)["rtt_ms"] is None or json.loads(seen.stdout)["errors"] == {}
    finally:
        car.terminate()
        out, _ = car.communicate(timeout=60)
        router.kill()
    assert out.startswith("car-7/lidar: ")


def test_files_of_others_are_left_and_said(tmp_path, capsys):
    make(tmp_path, ["hub.example"], ["car-7"], ["anna"])
    others = tmp_path / "my-own.json5", tmp_path / "vehicle-car-7.json5.part", tmp_path / "viewer-ben.json5"
    for other in others:
        other.write_text("mine")
    make(tmp_path, remove=["anna"])
    assert not (tmp_path / "viewer-anna.json5").exists()
    assert all(other.read_text() == "mine" for other in others)
    assert "my-own.json5 does not belong to this deployment and was left unchanged" in capsys.readouterr().out


def test_a_file_of_others_is_not_replaced(tmp_path):
    (tmp_path / "vehicle-x.json5").write_text("hello")
    with pytest.raises(SettingsError, match="does not belong to this deployment"):
        make(tmp_path, ["hub.example"], ["x"])
    assert (tmp_path / "vehicle-x.json5").read_text() == "hello"
    (tmp_path / "vehicle-x.json5").unlink()
    for _ in range(2):
        make(tmp_path, ["hub.example"], ["x"])


def test_calls_at_the_same_time_forget_nobody(tmp_path):
    """One of two lost its name: a certificate lay there that no later call would have renewed, or removed."""
    names = [f"viewer-{number}" for number in range(5)]
    calls = [start("certs", tmp_path, "--router", "a.example", "--viewer", name) for name in names]
    for call in calls:
        _, complaint = call.communicate(timeout=100)
        assert (call.returncode, complaint) == (0, "")
    assert sorted(json.loads((tmp_path / "deployment.json").read_text())["parties"]) == names
    rules = json.dumps(read(tmp_path / "router-a.example.json5")["access_control"])
    authority = x509.load_pem_x509_certificate((tmp_path / "ca.pem").read_bytes())
    for name in names:
        assert name in rules
        own = base64.b64decode(tls(tmp_path / f"viewer-{name}.json5")["connect_certificate_base64"])
        x509.load_pem_x509_certificate(own).verify_directly_issued_by(authority)


def test_one_that_fails_on_its_way_leaves_no_certificate_of_somebody_unknown(tmp_path):
    make(tmp_path, ["a.example"], [], ["anna", "ben"])
    router = tmp_path / "router-a.example.json5"
    router.unlink()
    (router / "in the way").mkdir(parents=True)
    with pytest.raises((SettingsError, SourceError)):
        make(tmp_path, [], [], ["carl"], remove=["ben"])
    assert {"anna", "ben", "carl"} == set(json.loads((tmp_path / "deployment.json").read_text())["parties"])
    (router / "in the way").rmdir()
    router.rmdir()
    make(tmp_path, [], [], ["carl"], remove=["ben"])  # the same again does it
    assert {"anna", "carl"} == set(json.loads((tmp_path / "deployment.json").read_text())["parties"])
    assert not (tmp_path / "viewer-ben.json5").exists()


def test_a_call_does_not_wait_without_end_for_another(tmp_path):
    with (
        locked(tmp_path),
        pytest.raises(SourceError, match="another command is changing"),
        locked(tmp_path, wait_s=0.2),
    ):
        pass
    with locked(tmp_path, wait_s=0.0):
        pass


def test_a_removed_name_is_given_to_nobody_while_its_old_certificate_is_valid(tmp_path):
    """Access rules go by the name in a certificate: the old one of a removed viewer opened what an operator may."""
    make(tmp_path, ["a.example"], ["car-7"], ["eve", "anna"])
    certs.run(tmp_path, viewers=["eve"], days=30)  # the older certificate is the one to outlive
    make(tmp_path, remove=["eve", "car-7"])
    for again in ({"operators": ["eve"]}, {"viewers": ["eve"]}, {"vehicles": ["car-7"]}, {"viewers": ["car-7"]}):
        with pytest.raises(SettingsError, match=r"was removed, and its old certificate is valid until .*another name"):
            make(tmp_path, **again)
    state = json.loads((tmp_path / "deployment.json").read_text())
    left_days = (datetime.fromisoformat(state["removed"]["eve"]) - datetime.now(UTC)).total_seconds() / 86400
    assert 89.9 < left_days < 90.1
    assert not (tmp_path / "operator-eve.json5").exists()
    assert "eve" not in json.dumps(read(tmp_path / "router-a.example.json5")["access_control"])
    state["removed"]["eve"] = (datetime.now(UTC) - timedelta(seconds=1)).isoformat()
    (tmp_path / "deployment.json").write_text(json.dumps(state))
    make(tmp_path, operators=["eve"])
    assert list(json.loads((tmp_path / "deployment.json").read_text())["removed"]) == ["car-7"]


def test_a_name_whose_command_was_killed_before_its_end_is_remembered_too(tmp_path):
    make(tmp_path, ["a.example"], [], ["anna"])
    router = tmp_path / "router-a.example.json5"
    router.unlink()
    (router / "in the way").mkdir(parents=True)
    with pytest.raises((SettingsError, SourceError)):
        make(tmp_path, [], [], ["carl"])
    (router / "in the way").rmdir()
    router.rmdir()
    make(tmp_path, remove=["carl"])
    with pytest.raises(SettingsError, match="was removed"):
        make(tmp_path, operators=["carl"])


def test_a_renewal_says_how_long_the_older_certificate_stays_valid(tmp_path, capsys):
    make(tmp_path, ["a.example"], ["car-7"], ["anna"])
    assert "older certificate" not in capsys.readouterr().out
    make(tmp_path, [], [], ["anna"])
    until = json.loads((tmp_path / "deployment.json").read_text())["parties"]["anna"]["longest"][:10]
    assert f"an older certificate of anna stays valid until {until}" in capsys.readouterr().out
    make(tmp_path)
    assert "older certificate" not in capsys.readouterr().out
    with pytest.raises(SettingsError, match="use only one"):
        make(tmp_path, [], [], ["anna"], remove=["anna"])


def test_with_passwords_a_removed_name_is_free_because_its_password_ends(tmp_path):
    make(tmp_path, ["a.example"], [], ["eve"], auth="password")
    old = dict(line.split(":") for line in (tmp_path / "users.txt").read_text().splitlines())["eve"]
    make(tmp_path, remove=["eve"])
    make(tmp_path, operators=["eve"])
    assert old not in (tmp_path / "users.txt").read_text()
