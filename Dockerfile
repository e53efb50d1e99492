# One image for coordinator and workers: `docker compose up` starts both, `docker run … worker` adds workers.
# The build argument EXTRAS chooses what is installed, see docs/how-to/run-with-docker.md:
#   docker build --tag brink:1.0.0 .
#   docker build --tag brink:1.0.0-vision --build-arg EXTRAS=analysis,postgres,vision .
# For x86-64 only: PyBullet has no wheels for ARM, and this image has no compiler.
FROM python:3.11-slim AS build
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY brink brink
COPY examples examples
COPY migrations migrations
COPY search search
COPY server server
COPY sim sim
COPY worker worker
ARG EXTRAS=analysis,postgres
RUN python -m venv /opt/brink && /opt/brink/bin/pip install --no-cache-dir -c constraints.txt ".[$EXTRAS]"

FROM python:3.11-slim
ARG EXTRAS=analysis,postgres
LABEL brink.extras=$EXTRAS
COPY --from=build /opt/brink /opt/brink
COPY examples /examples
RUN useradd --create-home --uid 1000 brink && mkdir /data && chown brink:brink /data
USER brink
WORKDIR /home/brink
ENV PATH=/opt/brink/bin:$PATH PYTHONUNBUFFERED=1
EXPOSE 8700
ENTRYPOINT ["brink"]
CMD ["serve", "--host", "0.0.0.0"]
