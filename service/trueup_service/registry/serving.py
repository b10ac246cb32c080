"""The serving pointer of a plant, and every position that it has had."""

from __future__ import annotations

from sqlalchemy import bindparam, select, update

from trueup.errors import PointerMoved
from trueup_service.registry import tables as t
from trueup_service.registry.records import Move
from trueup_service.registry.repository import Repository

_NOW = (
    select(t.moves)
    .join(
        t.serving,
        (t.moves.c.plant == t.serving.c.plant) & (t.moves.c.generation == t.serving.c.generation),
    )
    .where(t.serving.c.plant == bindparam("plant"))
)
_SWAP = (
    update(t.serving)
    .where(t.serving.c.plant == bindparam("of"), t.serving.c.generation == bindparam("from"))
    .values(generation=bindparam("to"))
)


class Serving(Repository[Move]):
    """Moves of serving pointers. A plant's pointer stands at one of its moves, by generation."""

    table, record = t.moves, Move

    def now(self, plant: str) -> Move | None:
        """Where the pointer of a plant stands now."""
        return self._one(_NOW, plant=plant)

    def at_generation(self, plant: str, generation: int) -> Move | None:
        """Where the pointer stood at a generation."""
        return self._by(plant=plant, generation=generation)

    def at_time(self, plant: str, at: str) -> Move | None:
        """Where the pointer stood at a time, None before the plant was registered."""
        query = select(t.moves).where(t.moves.c.plant == plant, t.moves.c.at <= at)
        return self._one(query.order_by(t.moves.c.generation.desc()).limit(1))

    def history(self, plant: str, after: int, limit: int) -> list[Move]:
        """Every position of the pointer by generation, from behind one."""
        return self._page(t.moves.c.generation, after, limit, t.moves.c.plant == plant)

    def has_served(self, plant: str, artifact: str) -> bool:
        """Whether the pointer of a plant ever stood at an artifact."""
        query = select(t.moves.c.generation).where(
            t.moves.c.plant == plant, t.moves.c.artifact == artifact
        )
        return self._connection.scalar(query.limit(1)) is not None

    def begin(self, move: Move) -> None:
        """Add the first position of a plant's pointer."""
        self.add(move)
        self._gateway.add(t.serving, {"plant": move.plant, "generation": move.generation})

    def move(self, move: Move) -> None:
        """Compare and swap: move the pointer if it stands one generation before. Raises
        PointerMoved."""
        to = {"of": move.plant, "from": move.generation - 1, "to": move.generation}
        if not self._gateway.run_update(_SWAP, to):
            raise PointerMoved(
                f"another move took generation {move.generation}", expected=move.generation - 1
            )
        self._gateway.note(t.serving, {"plant": move.plant, "generation": move.generation})
        self.add(move)
