"""The same in a bucket of moto's S3 server, with real processes."""

from __future__ import annotations

import json
import threading
import urllib.request
from pathlib import Path

import pytest

from lidarcodec.archive.archive import open_archive
from lidarcodec.archive.stores.table import open_store
from lidarcodec.errors import SourceError
from tests.archive.conftest import Bucket
from tests.archive.test_archive import FRAMES, payloads
from tests.command_line import run
from tests.faults.archive_store_errors import Proxy, proxied

pytestmark = [pytest.mark.sweep, pytest.mark.timeout(300)]


def archive(*words, code: int = 0, **variables):
    done = run("archive", *words, **variables)
    assert done.returncode == code, done.stderr
    return done


@pytest.fixture(scope="module")
def filled(bucket, drive):
    """The archive of the short drive in a bucket."""
    source = open_store("s3://fleet/in")
    for path in drive.rglob("*.pcap"):
        source.upload(str(path.relative_to(drive)), [path.read_bytes()])
    archive("run", "s3://fleet/in", "s3://fleet/out", "--seconds", "1", "--processes", "2", **bucket.variables)
    return "s3://fleet/out"


def test_packets_come_back_and_a_second_run_does_nothing(bucket, filled, drive, tmp_path):
    archive("get", filled, tmp_path / "back.pcap", **bucket.variables)
    assert payloads(tmp_path / "back.pcap") == payloads(drive / "car-7/roof/drive.pcap")
    done = archive("run", "s3://fleet/in", filled, "--seconds", "1", "--json", **bucket.variables)
    assert json.loads(done.stdout)["finished"] == 1


def test_a_frame_takes_three_requests_and_no_other_bytes(bucket, filled):
    (stamp,) = open_archive(filled).query("select max(stamp_ns) from frames where frame = 1")[1][0]
    before = len(bucket.requests())
    (frame,) = open_archive(filled).frames(vehicle="car-7", sensor="roof", between=(stamp, stamp))
    assert frame.stamp_ns == stamp
    assert len(bucket.requests()) - before == 3


def test_a_query_reads_the_tables_of_the_bucket(filled):
    ((count,),) = open_archive(filled).query("select count(*) from frames where vehicle = 'car-7'")[1]
    assert count == FRAMES


def test_of_many_that_create_an_object_one_wins(bucket):
    store, wins = open_store("s3://fleet/race"), []
    threads = [
        threading.Thread(target=lambda at=at: wins.append(at) if store.create("one", b"%d" % at) else None)
        for at in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    (winner,) = wins
    assert store.read("one") == b"%d" % winner


class CutsEverySecond(Proxy):
    """Cuts the connection of every second request before the store has seen it."""

    def fault(self) -> str:
        super().fault()
        return "cut before" if self.counts["requests"] % 2 else ""


def test_every_request_survives_a_cut_connection(bucket, monkeypatch):
    """On a mobile link connections are cut all the time."""
    with proxied(bucket.port, 0, CutsEverySecond) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{proxy.server_address[1]}")
        store = open_store("s3://fleet/cut")
        for round_ in range(3):
            name = f"a-{round_}"
            assert store.entry(name) is None
            store.create(name, b"data")
            assert store.size(name) == 4
            assert store.read(name) == b"data"
            assert [entry.name for entry in store.entries()] == [name]
            store.delete(name)
            assert store.entry(name) is None


def test_a_name_that_leaves_the_prefix_is_refused(bucket):
    bucket.put("bad/a/../../in/drive.pcap", b"outside")
    with pytest.raises(SourceError, match="points outside of its prefix"):
        list(open_store("s3://fleet/bad").entries())


def test_the_policy_of_the_compose_file_is_enough_for_its_bucket_and_for_no_other(tmp_path, monkeypatch):
    boto3 = pytest.importorskip("boto3", reason="needs boto3, which moto brings")
    policy = (Path(__file__).parents[2] / "docker" / "archive-policy.json").read_text()
    server = Bucket(tmp_path)
    try:
        url = server.variables["AWS_ENDPOINT_URL"]
        owner = {"endpoint_url": url, "region_name": "us-east-1"}
        owner |= {"aws_access_key_id": "test", "aws_secret_access_key": "test"}
        boto3.client("s3", **owner).create_bucket(Bucket="other")
        iam = boto3.client("iam", **owner)
        iam.create_user(UserName="archive")
        iam.put_user_policy(UserName="archive", PolicyName="fleet", PolicyDocument=policy)
        key = iam.create_access_key(UserName="archive")["AccessKey"]
        begin = urllib.request.Request(f"{url}/moto-api/reset-auth", b"0", {"Content-Type": "text/plain"})
        urllib.request.urlopen(begin, timeout=5).close()  # from here on moto keeps to policies
        for name, value in server.variables.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setenv("AWS_ACCESS_KEY_ID", key["AccessKeyId"])
        monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", key["SecretAccessKey"])
        store, other = (open_store(f"s3://{name}/x", retry_s=1) for name in ("fleet", "other"))
        assert [store.create("a", b"1"), store.create("a", b"2"), store.read("a")] == [True, False, b"1"]
        store.upload("large", [bytes(6_000_000)] * 2)
        assert [(one.name, one.size) for one in store.entries()] == [("a", 1), ("large", 12_000_000)]
        with pytest.raises(OSError, match="403"):
            list(other.entries())
        with pytest.raises(OSError, match="403"):
            other.create("a", b"1")
    finally:
        server.close()
