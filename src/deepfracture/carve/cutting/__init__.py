"""The original mesh and the crack interfaces, divided where they meet: closed fragments."""
