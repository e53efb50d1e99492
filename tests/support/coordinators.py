"""Two coordinators' steppers on one database, as two processes have them, and whoever simulates for them."""

import json
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from sqlalchemy import Connection

from brink.search.algorithm import Proposal, SeedRequest
from brink.search.archive import archive_digest
from brink.server.campaigns import step_store, store
from brink.server.campaigns.advance import Stepper
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import first_generations, make_plan, restored_archive
from brink.server.campaigns.store import Campaign
from brink.server.db.engine import Engines
from brink.server.db.writer import Writer
from brink.server.problems.base import Problem
from brink.server.queue.report_store import Outcome
from brink.server.seeding import LlmCall
from brink.worker.wire import Completed, LeasedJob
from support.problems import SIMULATOR, simulated
from support.queue import Queue


class NoSeeds:
    """Never has any: algorithms then make their own, once it has said so."""

    def __init__(self) -> None:
        self.says: Sequence[Proposal] | None = ()

    def proposals(
        self, campaign_id: str, settings: object, problem: Problem, request: SeedRequest
    ) -> Sequence[Proposal] | None:
        return self.says

    def doing(self, campaign_id: str) -> str | None:
        return None

    def calls(self, connection: Connection, campaign_id: str) -> list[LlmCall]:
        return []

    def close(self) -> None: ...


class Coordinators:
    """Two steppers, each with a writer of its own, on one database: as two processes have them."""

    def __init__(
        self, engines: Engines, body: dict[str, Any], simulated: Callable[[Any], Completed] = simulated
    ) -> None:
        self.simulated = simulated
        self.seeds = [NoSeeds() for _ in range(2)]
        self.engines, self.queue = engines, Queue(engines=engines)
        self.writers = [Writer(engines.writer) for _ in range(2)]
        self.steppers = [self.stepper(place) for place in range(2)]
        self.body = parse_body(body)
        live, asked = first_generations(self.body)

        def unit(connection: Connection) -> None:
            row = store.campaign_row("c0ffee", self.body, self.body.document_hash())
            store.insert_campaigns(connection, [row])
            found = store.CAMPAIGNS.find(connection, "c0ffee")
            assert found is not None
            step_store.insert_generations(connection, found, asked)

        self.queue.run(unit)
        self.steppers[0].adopt("c0ffee", live)

    def stepper(self, place: int) -> Stepper:
        """Return the stepper of a coordinator that has just started."""
        return Stepper(self.engines, self.writers[place], max_stored_distances=1000, seeds=self.seeds[place])

    def close(self) -> None:
        for writer in self.writers:
            writer.close()

    @property
    def campaign(self) -> Campaign:
        found = self.queue.run(lambda connection: store.CAMPAIGNS.find(connection, "c0ffee"))
        assert found is not None
        return found

    def simulate(self) -> None:
        """Simulate all that is queued."""
        while jobs := self.lease():
            self.report(jobs)

    def lease(self) -> Sequence[LeasedJob]:
        """Lease the jobs that are queued, at most as many as one request may lease."""
        return self.queue.lease(capabilities=(SIMULATOR, "brink-encounter@2"))

    def report(self, jobs: Iterable[LeasedJob]) -> None:
        """Simulate and report the jobs."""
        specs = {job.job: json.loads(self.queue.job(job.job).spec) for job in jobs}
        self.queue.report(
            *(
                Outcome(job=j.job, token=j.token, result=self.simulated(specs[j.job]).model_dump_json())
                for j in jobs
            )
        )

    def digest(self) -> str:
        plan = make_plan(self.body)
        with self.engines.reader.connect() as connection:
            stored = step_store.read_archive(connection, "c0ffee", plan.problem.space.dimension)
        return archive_digest(restored_archive(plan, stored))
