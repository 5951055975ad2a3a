"""Many runs of filters, kept on disk, and what they say: a report and a verdict."""
