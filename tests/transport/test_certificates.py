"""A certificate that ends is said before: a vehicle whose own one had ended sent to nobody, and did not say why."""

from __future__ import annotations

import contextlib
import random
import signal
import threading
from datetime import UTC, datetime, timedelta

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.transport import Endpoints, certificates_of, open_transport
from lidarcodec.transport.certificates import Certificates, CertificateWatch, Validity, validities
from tests.apps.streams import Loop
from tests.command_line import start
from tests.transport.secured import deployment
from tests.transport.test_contract import eventually

pytest.importorskip("cryptography")
from cryptography import x509

pytestmark = pytest.mark.timeout(240)
NOW = datetime(2026, 11, 24, 12, 0, tzinfo=UTC)
DAY = timedelta(days=1)


def test_the_validity_is_that_which_x509_says_and_no_bytes_do_any_harm(tmp_path):
    deployment(tmp_path)
    pem = (tmp_path / "ca.pem").read_bytes()
    truth = x509.load_pem_x509_certificate(pem)
    assert validities(pem + pem) == [Validity(truth.not_valid_before_utc, truth.not_valid_after_utc)] * 2
    assert validities(b"") == []
    rng = random.Random(7)
    for _ in range(3000):
        damaged = bytearray(pem)
        for _ in range(rng.randint(1, 4)):
            damaged[rng.randrange(len(damaged))] = rng.choice(b"ABCDEFxyz019+/=\n")
        with contextlib.suppress(ValueError):
            validities(bytes(damaged))


@pytest.mark.parametrize("text", ["491231235959Z", "20491231235959Z", "500101000000Z"])
def test_years_of_two_digits_are_those_of_this_century_until_2049(text):
    from lidarcodec.transport.certificates import _time

    tag = 0x17 if len(text) == 13 else 0x18
    found, _ = _time(bytes([tag, len(text)]) + text.encode(), 0)
    assert found.year == (1950 if text.startswith("50") else 2049)


@pytest.mark.parametrize(
    ("at", "state", "said"),
    [
        (NOW - 100 * DAY, "not yet valid", "are not valid yet"),
        (NOW, "valid", None),
        (NOW + 11 * DAY, "ends soon", "in 29 days; renew it"),
        (NOW + 40 * DAY, "ended", "ended on 2027-01-03 12:00 UTC"),
    ],
)
def test_the_state_is_that_of_the_one_which_ends_first(at, state, said):
    found = Certificates(
        {
            "certificate": Validity(NOW - DAY, NOW + 40 * DAY),
            "certificate of the authority": Validity(NOW - DAY, NOW + 400 * DAY),
        }
    )
    assert found.state(at) == (state, NOW + 40 * DAY)
    told = found.complaint("car-7.json5", at)
    assert told is None if said is None else said in told
    assert told is None or "car-7.json5" in told


def test_it_is_said_when_it_comes_to_its_end_and_once_a_day(caplog):
    now = [NOW]
    watch = CertificateWatch(
        Certificates({"certificate": Validity(NOW - DAY, NOW + 30 * DAY)}), "a.json5", lambda: now[0]
    )
    waits = []
    while now[0] < NOW + 33 * DAY:
        waits.append(watch._look(watch._certificates))
        now[0] += timedelta(minutes=30)
    assert set(waits) == {60.0}
    assert len([line for line in caplog.messages if "ends on" in line]) == 30
    assert len([line for line in caplog.messages if "ended on" in line]) == 3


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(("publish", "sim:street?sensor=vlp16&frames=100000"), marks=pytest.mark.sweep),
        pytest.param(("subscribe", "car-7/lidar"), marks=pytest.mark.sweep),
        ("serve", "--port", 0, "--database-url", "sqlite:///{folder}/server.db", "--recordings", "{folder}/recordings"),
        pytest.param(("bridge", "foxglove", "car-7/lidar", "--port", 0), marks=pytest.mark.sweep),
    ],
    ids=lambda words: words[0],
)
def test_every_command_that_connects_says_when_its_certificate_ends_and_that_it_has(tmp_path, command):
    if command[0] == "bridge":
        pytest.importorskip("foxglove")
    deployment(tmp_path, days=8 / 86400)
    name = "vehicle-car-7" if command[0] == "publish" else "operator-olga"
    words = [str(word).format(folder=tmp_path) for word in command]
    process = start(*words, "--zenoh-config", tmp_path / f"{name}.json5")
    said: list[str] = []
    reading = threading.Thread(target=lambda: said.extend(process.stderr), daemon=True)
    reading.start()
    assert eventually(lambda: any(f"{name}.json5 ended on" in line for line in said), 60.0), said
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 0
    process.stdout.close()
    reading.join(20)
    (line,) = [line for line in said if "ended on" in line]
    assert "renew it with `lidarcodec certs`" in line


def test_the_status_has_it(tmp_path):
    deployment(tmp_path, days=20)
    endpoints = Endpoints.of(config=tmp_path / "vehicle-car-7.json5")
    found = certificates_of(endpoints)
    assert found is not None
    told = Publisher(Loop(1), vehicle="car-7", endpoints=endpoints).status()["certificate"]
    assert told == {"state": "ends soon", "until": found.state().until.isoformat()}
    live = LiveStream("car-7/lidar", endpoints=Endpoints.of(config=tmp_path / "viewer-anna.json5"))
    assert live.summary()["certificate"]["state"] == "ends soon"
    assert certificates_of(Endpoints()) is None
    assert Publisher(Loop(1)).status()["certificate"] is None


def test_a_session_that_is_closed_leaves_nobody_watching(tmp_path):
    deployment(tmp_path, routers=(), vehicles=("car-7@127.0.0.1",))
    open_transport(Endpoints.of(config=tmp_path / "vehicle-car-7.json5")).close()

    def watching() -> bool:
        return any(thread.name == "lidarcodec certificates" for thread in threading.enumerate())

    assert eventually(lambda: not watching())
