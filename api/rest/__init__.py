"""REST: the application, its middleware, problems, routes and schemas."""
