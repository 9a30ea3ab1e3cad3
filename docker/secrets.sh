#!/bin/sh
# Makes passwords that are not there yet, in secrets/ beside this file; never changes one. Only the owner of the folder gets
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
if [ ! -s secrets/archive.env ]; then # the S3 server of compose.archive.yaml, and those who use it
  key=$(head -c 24 /dev/urandom | base64 | tr '+/' '-_' | tr -d '\n')
  printf 'AWS_ACCESS_KEY_ID=archive\nAWS_SECRET_ACCESS_KEY=%s\nMINIO_ROOT_USER=archive\nMINIO_ROOT_PASSWORD=%s\n' "$key" "$key" >secrets/archive.env.part
  mv secrets/archive.env.part secrets/archive.env
  echo "made secrets/archive.env"
fi
[ -s secrets/metrics_token ] || cat <<'END'
secrets/metrics_token is for Prometheus; when the images are built:
  docker compose run --rm -T server token create prometheus --role viewer > secrets/metrics_token && chmod 444 secrets/metrics_token
END
