"""The procrastinate application of the queue comparison, loaded by procrastinate's workers."""

import os

from procrastinate import App, PsycopgConnector

URL_VARIABLE = "BENCH_POSTGRES_URL"

app = App(connector=PsycopgConnector(conninfo=os.environ.get(URL_VARIABLE, ""), max_size=20))


@app.task(queue="bench")  # type: ignore[untyped-decorator, unused-ignore]
async def no_op(number: int) -> None:
    """Do nothing."""
