#!/bin/sh
# Makes passwords that are not there yet, in secrets/ beside this file; never changes one that compose files still use. Only the owner of the folder gets
# into it, so the files may be read by all: in its container each is for a user that this machine does not know.
set -eu
cd "$(dirname "$0")"
umask 077
mkdir -p secrets
for name in database_password grafana_password; do
  [ -s "secrets/$name" ] && continue
  head -c 24 /dev/urandom | base64 | tr '+/' '-_' | tr -d '\n' >"secrets/$name.part"
  chmod 444 "secrets/$name.part"
  mv "secrets/$name.part" "secrets/$name"
  echo "made secrets/$name"
done
# compose.archive.yaml: the owner of the S3 server, and the user of those who work in its bucket
for file in "store MINIO_ROOT_USER=owner MINIO_ROOT_PASSWORD=" "archive AWS_ACCESS_KEY_ID=archive AWS_SECRET_ACCESS_KEY="; do
  set -- $file
  [ -s "secrets/$1.env" ] && grep -q "^${2%%=*}=" "secrets/$1.env" && continue
  printf '%s\n%s%s\n' "$2" "$3" "$(head -c 24 /dev/urandom | base64 | tr '+/' '-_' | tr -d '\n')" >"secrets/$1.env.part"
  mv "secrets/$1.env.part" "secrets/$1.env"
  echo "made secrets/$1.env"
done
[ -s secrets/metrics_token ] || cat <<'END'
secrets/metrics_token is for Prometheus; when the images are built:
  docker compose run --rm -T server token create prometheus --role viewer > secrets/metrics_token && chmod 444 secrets/metrics_token
END
