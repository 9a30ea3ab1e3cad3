"""What an archive is deployed with: image, compose file, Kubernetes manifests, and the timer of a vehicle."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from importlib.resources import files

import pytest
import yaml

from tests.images.compose import FOLDER, read, service_networks
from tests.images.dockerfile import ROOT, copied, parse
from tests.images.test_dockerfile import check_words

COMPOSE = read("compose.archive.yaml")
SERVICES = COMPOSE["services"]
MANIFESTS = sorted((ROOT / "packaging" / "kubernetes").glob("*.yaml"))
STAGES = list(parse((FOLDER / "archive.Dockerfile").read_text()))
VERSION = "1.30"
"""Of Kubernetes, whose schema the manifests have to fit."""
PINNED = re.compile(r"[\w./-]+:[\w.-]+@sha256:[0-9a-f]{64}")
OURS = "lidarcodec-archive:1.0.0"
OWNER = "./secrets/store.env"
"""Keys of the owner of the S3 server, which only the server has, and what makes the bucket."""
KEYS = {"volume": [], "scheduler": [], "store": [OWNER], "bucket": ["./secrets/archive.env", OWNER]}


def documents():
    return [(path, one) for path in MANIFESTS for one in yaml.safe_load_all(path.read_text())]


def pods():
    """Every pod that a manifest makes."""
    for _, one in documents():
        spec = one["spec"]
        spec = spec["jobTemplate"]["spec"] if one["kind"] == "CronJob" else spec
        if "template" in spec:
            yield spec["template"]["spec"]


def check_programs(words, command=None):
    """Words of ours are those of a command that exists; others start a program of Dask that exists."""
    if not command:
        check_words([" ".join(words[:2]), *words[2:]])
        return
    assert command[:2] == ["python", "-m"]
    pytest.importorskip("distributed", reason="needs the extra cluster")
    asked = subprocess.run(
        [sys.executable, "-m", command[2], "--help"], capture_output=True, text=True, timeout=60, check=True
    )
    for word in words:
        assert not word.startswith("--") or word in asked.stdout, word


def test_the_compose_file_is_what_the_specification_allows():
    jsonschema = pytest.importorskip("jsonschema", reason="needs jsonschema")
    pytest.importorskip("check_jsonschema", reason="needs check-jsonschema, which has the schema of the specification")
    jsonschema.validate(
        COMPOSE, json.loads((files("check_jsonschema") / "builtin_schemas/vendor/compose-spec.json").read_text())
    )


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_can_do_little_and_is_of_one_version(name):
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert "no-new-privileges:true" in service["security_opt"]
    assert {"cpus", "memory", "pids"} <= set(service["deploy"]["resources"]["limits"])
    assert service["image"] == OURS or PINNED.fullmatch(service["image"])
    assert service["env_file"] == KEYS.get(name, ["./secrets/archive.env"])
    assert ("cap_add" in service) == (name == "volume")
    assert not [key for key in service["environment"] if re.search("SECRET|PASSWORD|ACCESS_KEY", key)]
    assert set(service.get("depends_on", {})) <= set(SERVICES)
    for port in service.get("ports", []):
        assert re.match(r"\$\{[A-Z]+_ADDRESS:-127\.0\.0\.1\}:\d+:\d+$", port)


def test_the_server_gets_a_volume_that_it_can_write():
    """A new volume belongs to root, and the image has no folder for it."""
    volume, store = SERVICES["volume"], SERVICES["store"]
    assert volume["command"] == [f"chown {store['user']} /data"]
    assert (volume["user"], volume["cap_add"], volume["network_mode"]) == ("0:0", ["CHOWN"], "none")
    assert volume["volumes"] == store["volumes"] == ["store:/data"]
    assert store["depends_on"] == {"volume": {"condition": "service_completed_successfully"}}


def test_nobody_else_reaches_dask():
    assert COMPOSE["networks"]["work"]["internal"] is True
    for name in ("scheduler", "worker", "archive"):
        assert service_networks(SERVICES[name]) == {"work"}
        assert "ports" not in SERVICES[name]


@pytest.mark.sweep
def test_programs_of_the_compose_file_know_their_words():
    for name in ("scheduler", "worker", "archive"):
        check_programs(SERVICES[name]["command"], SERVICES[name].get("entrypoint"))


def test_the_image_is_made_of_the_vehicle_and_of_packages_with_hashes():
    assert next(stage.base for stage in STAGES if stage.name == "packages").startswith("python:")
    run = next(one.value for stage in STAGES for one in stage.all("RUN"))
    assert "--require-hashes" in run
    for copy in (copied(one) for stage in STAGES for one in stage.all("COPY")):
        assert copy.stage or all((ROOT / source).exists() for source in copy.sources)
    check_words(["archive query", *STAGES[-1].last("CMD").words[2:]])
    program = shutil.which("hadolint")
    if program:
        done = subprocess.run(
            [program, FOLDER / "archive.Dockerfile"], capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 0, done.stdout


def test_keys_of_the_store_are_made_once(tmp_path):
    script, made = shutil.copy(FOLDER / "secrets.sh", tmp_path), []
    for _ in range(2):
        subprocess.run(["sh", script], capture_output=True, check=True, timeout=60)
        made.append([(tmp_path / "secrets" / f"{name}.env").read_text() for name in ("store", "archive")])
    assert made[0] == made[1]
    owner, user = (dict(line.split("=", 1) for line in text.splitlines()) for text in made[0])
    assert owner.keys() == {"MINIO_ROOT_USER", "MINIO_ROOT_PASSWORD"}
    assert user.keys() == {"AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"}
    assert owner["MINIO_ROOT_USER"] != user["AWS_ACCESS_KEY_ID"]
    assert owner["MINIO_ROOT_PASSWORD"] != user["AWS_SECRET_ACCESS_KEY"]
    assert len(user["AWS_SECRET_ACCESS_KEY"]) == len(owner["MINIO_ROOT_PASSWORD"]) == 32


@pytest.mark.parametrize(
    ("path", "manifest"), documents(), ids=lambda one: one["kind"] if isinstance(one, dict) else ""
)
def test_a_manifest_is_what_kubernetes_allows(path, manifest):
    validate = pytest.importorskip("kubernetes_validate", reason="needs kubernetes-validate, which has the schemas")
    validate.validate(manifest, VERSION, strict=True)
    with pytest.raises(validate.ValidationError):
        validate.validate(manifest | {"spec": {"imagine": "nothing"}}, VERSION, strict=True)


def test_pods_can_do_little_and_start_what_exists():
    found = list(pods())
    assert len(found) == 4
    for pod in found:
        assert pod["automountServiceAccountToken"] is False
        assert pod["securityContext"]["runAsNonRoot"] is True
        for one in pod["containers"]:
            assert one["image"] == OURS
            closed = one["securityContext"]
            assert (closed["readOnlyRootFilesystem"], closed["allowPrivilegeEscalation"]) == (True, False)
            assert closed["capabilities"] == {"drop": ["ALL"]}
            assert "memory" in one["resources"]["limits"]
            if "command" not in one:
                check_programs(one["args"])
    kinds = [one["kind"] for _, one in documents()]
    assert {"CronJob", "Job", "Deployment", "Service", "NetworkPolicy"} == set(kinds)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_takes_the_timer_of_a_vehicle(tmp_path):
    for name in ("lidarcodec-push.service", "lidarcodec-push.timer"):
        text = (ROOT / "packaging" / name).read_text()
        (tmp_path / name).write_text(text.replace("/opt/lidarcodec/bin/lidarcodec", sys.executable))
    units = [tmp_path / "lidarcodec-push.service", tmp_path / "lidarcodec-push.timer"]
    done = subprocess.run(
        ["systemd-analyze", "verify", *units], capture_output=True, text=True, check=False, timeout=60
    )
    assert not [line for line in done.stderr.splitlines() if "lidarcodec-push" in line], done.stderr
