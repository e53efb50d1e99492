"""The Celery application of the queue comparison, loaded by ``celery -A benchmarks.celery_app worker``."""

import os
import time

from celery import Celery

URL_VARIABLE = "BENCH_REDIS_URL"

app = Celery("bench", broker=os.environ.get(URL_VARIABLE), backend=os.environ.get(URL_VARIABLE))
app.conf.update(
    task_acks_late=True,
    task_reject_on_worker_lost=True,
    worker_prefetch_multiplier=8,
    worker_hijack_root_logger=False,
    broker_connection_retry_on_startup=True,
    result_expires=None,
)


@app.task  # type: ignore[untyped-decorator, unused-ignore]
def no_op() -> float:
    """Return the current time, in seconds since the epoch."""
    return time.time()
