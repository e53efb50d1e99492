"""A language model as a seeder: settings, wire protocol, prompts, checked replies, budget."""
