"""Define the subcommands of the bench, a module each; heavy imports happen when they run."""
