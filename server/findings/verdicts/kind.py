"""Verdicts as a kind of finding, for campaigns that have no other."""

from brink.server.campaigns.plan import Plan
from brink.server.findings.finding import Finding, Role
from brink.server.findings.kind import Kind, Listed, Subject
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.words import counted
from brink.server.states import OutcomeKind

COLUMNS = [
    Column(name="outcome", title="outcome"),
    Column(name="verdict", title="verdict", format=Format.STATE),
    Column(name="solutions", title="solutions", format=Format.COUNT),
    Column(name="share", title="share", format=Format.SHARE),
]
_VERDICTS = {
    OutcomeKind.HELD: "safe",
    OutcomeKind.OTHER: "safe, another requirement violated",
    OutcomeKind.VIOLATED: "unsafe",
}


class VerdictsKind(Kind):
    """How many solutions violate the requirement."""

    id = "verdicts"
    title = "Requirements held and violated"
    rank = 100

    def role(self, plan: Plan) -> Role:
        """Return the role of verdicts, which every campaign has besides its main findings."""
        return Role.SIDE

    async def find(self, subject: Subject) -> Finding:
        """Return how often each outcome occurred."""
        campaign, read = subject.campaign, subject.read
        outcomes = await subject.sources.outcomes.get(campaign.id, read)
        violate = outcomes.kind_words(OutcomeKind.VIOLATED) if outcomes.requirements else "are unsafe"
        order = list(_VERDICTS)
        groups = sorted(
            zip(outcomes.groups, outcomes.counts.tolist(), strict=True),
            key=lambda one: (-order.index(one[0].kind), -one[1], one[0].words),
        )
        rows = [
            [group.words, _VERDICTS[group.kind], count, count / len(read.archive)]
            for group, count in groups[: subject.rows]
        ]
        recorded = outcomes.recorded
        legend = []
        if any(group.others for group in outcomes.groups):
            legend = [
                "Safe and unsafe are with regard to the requirements of the campaign alone: a safe "
                f"{subject.noun} may violate another one"
            ]
        if 0 < recorded < len(read.archive):
            missing = counted(len(read.archive) - recorded, subject.noun)
            legend.append(f"For {missing}, other requirements were not recorded")
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=f"{campaign.unsafe:,} of {campaign.evaluated:,} solutions {violate}",
            legend=legend,
            tables=[
                Table(
                    name="verdicts",
                    title="What the simulations showed",
                    columns=COLUMNS,
                    rows=rows,
                    left_out=len(groups) - len(rows),
                )
            ],
        )

    def brief(self, listed: Listed) -> str:
        """Return how many solutions are unsafe."""
        return f"{listed.campaign.unsafe:,} unsafe"


KIND = VerdictsKind()
