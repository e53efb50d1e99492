"""What procrastinate's workers run, told by their environment."""

import os

from procrastinate import App, PsycopgConnector

URL_VARIABLE = "BENCH_POSTGRES_URL"

app = App(connector=PsycopgConnector(conninfo=os.environ.get(URL_VARIABLE, ""), max_size=20))


@app.task(queue="bench")  # type: ignore[untyped-decorator, unused-ignore]
async def nothing(number: int) -> None:
    """Do nothing."""
