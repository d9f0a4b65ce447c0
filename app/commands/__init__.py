"""The commands of the command line, a file each: its options and its run."""
