"""Alembic's entry: migrate on the connection that is handed in."""

from alembic import context

from trueup_service.registry.tables import metadata

context.configure(connection=context.config.attributes["connection"], target_metadata=metadata, transactional_ddl=False)
context.run_migrations()
