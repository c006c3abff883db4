"""Results of the solvers: statuses, histories, fields, forces, and files that keep them."""
