# One image for coordinator and workers: `docker compose up` starts both, `docker run … worker` adds workers.
FROM python:3.11-slim AS build
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY brink brink
COPY migrations migrations
COPY search search
COPY server server
COPY sim sim
COPY worker worker
RUN python -m venv /opt/brink && /opt/brink/bin/pip install --no-cache-dir -c constraints.txt '.[analysis,postgres]'

FROM python:3.11-slim
COPY --from=build /opt/brink /opt/brink
COPY examples /examples
RUN useradd --create-home --uid 1000 brink
USER brink
WORKDIR /home/brink
ENV PATH=/opt/brink/bin:$PATH PYTHONUNBUFFERED=1
EXPOSE 8700
ENTRYPOINT ["brink"]
CMD ["serve", "--host", "0.0.0.0"]
