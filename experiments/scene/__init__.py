"""What an experiment is made of: settings from files, scenarios, starts, filters."""
