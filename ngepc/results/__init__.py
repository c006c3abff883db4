"""What a solver gives back and how it is kept: statuses, histories, fields, forces, files."""
