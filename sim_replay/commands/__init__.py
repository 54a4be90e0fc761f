"""The subcommands of the bench, a module each. Whatever is heavy they import when they run."""
