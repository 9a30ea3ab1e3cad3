# What works on an archive: the vehicle's image, with object storage, SQL and Dask. Build that one first (docs/images.md):
#   docker build -f docker/Dockerfile --target vehicle -t lidarcodec-vehicle:1.0.0 .
#   docker build -f docker/archive.Dockerfile -t lidarcodec-archive:1.0.0 .
ARG PYTHON_IMAGE=python:3.11.16-slim-bookworm@sha256:528257d48c1da0dcecc2e725d1ae34498d60c965f1241e39cd6a85a8859bdf84
ARG VEHICLE_IMAGE=lidarcodec-vehicle:1.0.0

FROM ${VEHICLE_IMAGE} AS vehicle

# The vehicle's image has no pip.
FROM ${PYTHON_IMAGE} AS packages
COPY requirements/image-archive.txt /tmp/
COPY --from=vehicle /opt/lidarcodec /opt/lidarcodec
RUN pip --python /opt/lidarcodec/bin/python install --no-cache-dir --require-hashes --requirement /tmp/image-archive.txt

FROM vehicle
LABEL org.opencontainers.image.title="lidarcodec archive" \
      org.opencontainers.image.description="Compresses, checks and finds recordings of a fleet in object storage."
COPY --from=packages /opt/lidarcodec /opt/lidarcodec
HEALTHCHECK NONE
CMD ["archive", "--help"]
