"""The discrete problem itself: dual variables at the integration points, nothing regularised."""
