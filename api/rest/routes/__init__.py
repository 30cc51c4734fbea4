"""The service's routes, a file a resource."""
