"""Subcommands of the command line, one file each: they read arguments, call what does the work, and print."""
