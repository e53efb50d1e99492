"""A language model as a seeder: settings, wire, prompts, checked replies, budget."""
