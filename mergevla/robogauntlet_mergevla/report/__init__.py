"""The section of the report about merging: what merging experts and inferring the task cost."""
