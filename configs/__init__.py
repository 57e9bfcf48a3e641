"""What to do: run configurations, their schema, and the YAML files that ship with huesphere."""
