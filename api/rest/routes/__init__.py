"""The service's routes, a module a resource; what they share is in `shared`."""
