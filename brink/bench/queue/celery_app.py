"""What Celery's workers run: ``celery -A brink.bench.queue.celery_app worker``, told by its environment."""

import os
import time

from celery import Celery

URL_VARIABLE = "BENCH_REDIS_URL"
QUEUE = "celery"

app = Celery("bench", broker=os.environ[URL_VARIABLE], backend=os.environ[URL_VARIABLE])
app.conf.update(
    task_acks_late=True,
    task_reject_on_worker_lost=True,
    worker_prefetch_multiplier=8,
    worker_hijack_root_logger=False,
    broker_connection_retry_on_startup=True,
    result_expires=None,
)


@app.task  # type: ignore[untyped-decorator, unused-ignore]
def nothing() -> float:
    """Do nothing; return when."""
    return time.time()
