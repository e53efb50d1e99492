"""The boundary that a campaign found, for others: tables, rules, and what the component saw and said."""
