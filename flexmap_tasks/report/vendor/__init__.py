"""Libraries of others that the report carries inside; see NOTICE."""
