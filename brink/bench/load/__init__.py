"""Jobs that cost what a measurement wants them to cost."""
