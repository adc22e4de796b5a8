# The service, and the simulated aircraft of the demo. `docker build -t gcs-coloc .`; how it is run: docs/how-to/deploy.md.
# No syntax of BuildKit's own, so that docker-compose 1.29 and engines without BuildKit build it as well.
ARG PYTHON_IMAGE=python:3.11-slim-bookworm

FROM ${PYTHON_IMAGE} AS dependencies
ARG PIP_INDEX_URL
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /src
COPY requirements.lock ./
# Without what packages bring for their own tests, and pymavlink's dialects that nobody here speaks: a quarter of their size.
RUN python -m venv --without-pip /opt/gcs-coloc \
 && python -m pip --python /opt/gcs-coloc/bin/python install --require-hashes --only-binary :all: -r requirements.lock \
 && cd /opt/gcs-coloc/lib/python3.*/site-packages \
 && find . -depth -type d -name tests -exec rm -r {} + \
 && rm -r pymavlink/dialects/v10 \
 && find pymavlink/dialects/v20 -type f ! -name '__init__.*' ! -name 'ardupilotmega.*' ! -name 'development.*' -delete

FROM dependencies AS build
COPY . ./
RUN python -m pip wheel --no-deps --wheel-dir /wheels . \
 && python -m pip --python /opt/gcs-coloc/bin/python install --no-deps --no-index --prefix /opt/own /wheels/*.whl

FROM ${PYTHON_IMAGE}
LABEL org.opencontainers.image.title="gcs-coloc" \
      org.opencontainers.image.description="Locates a UAV whose GPS has failed from its ranges to neighbours" \
      org.opencontainers.image.version="0.2.0" \
      org.opencontainers.image.licenses="MIT"
# The user's number is fixed, so that files of the host can be given to it. A new volume takes the owner of these directories.
RUN groupadd --gid 10001 gcs-coloc \
 && useradd --uid 10001 --gid gcs-coloc --no-create-home --home-dir /nonexistent --shell /usr/sbin/nologin gcs-coloc \
 && install -d -o gcs-coloc -g gcs-coloc -m 0750 /var/lib/gcs-coloc/recordings /var/lib/gcs-coloc/secrets
# In two layers: a new version of the project alone is a small one.
COPY --from=dependencies /opt/gcs-coloc /opt/gcs-coloc
COPY --from=build /opt/own /opt/gcs-coloc
ENV PATH=/opt/gcs-coloc/bin:$PATH PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1
USER 10001:10001
WORKDIR /var/lib/gcs-coloc
ENTRYPOINT ["gcs-coloc"]
HEALTHCHECK --interval=10s --timeout=5s --start-period=30s --retries=3 \
    CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8080/healthz', timeout=4)"]
