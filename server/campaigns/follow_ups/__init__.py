"""Follow-ups: campaigns that ask something about solutions of another campaign.

A campaign provides all that a follow-up needs: workers, progress, resuming, no lost result. A row of the table
`follow_ups` says which campaign it asks about, what (`FollowUpKind`), and about which solutions (`Selection`).

Each kind is a module of `kinds` that defines `QUESTION`. A new kind also takes a member of `FollowUpKind` and a
migration of the table's check.
"""
