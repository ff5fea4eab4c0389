"""Which variables of a function outlive the block that sets them: those are declared at its top, others in place."""

import ast
from collections.abc import Iterable, Sequence

Block = Sequence[ast.stmt]
WRITTEN_OUT = 4  # turns of a loop over a literal range that are written one after the other


class Lives:
    """Of a function's body: `outliving`, the names that a loop or a branch sets and that are read after it, or in the
    loop's next turn, and `idle`, the assignments to a name that nothing reads before the next.
    """

    def __init__(self, body: Block) -> None:
        self.outliving: set[str] = set()
        self._read: dict[ast.stmt, bool] = {}
        _before(body, set(), self)

    def see(self, statement: ast.stmt, after: set[str]) -> None:
        """Note what is read after a statement; of a loop's body the last time counts, which knows all turns."""
        if isinstance(statement, ast.Assign) and all(isinstance(target, ast.Name) for target in statement.targets):
            self._read[statement] = bool(sets(statement.targets) & after)

    @property
    def idle(self) -> set[ast.stmt]:
        """The assignments without an effect."""
        return {statement for statement, read in self._read.items() if not read}


def reads(node: ast.AST) -> set[str]:
    """The names that an expression or statement reads."""
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Load)}


def sets(nodes: Iterable[ast.AST]) -> set[str]:
    """The names that are set anywhere in the statements."""
    parts = [part for node in nodes for part in ast.walk(node)]
    return {part.id for part in parts if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)}


def written_out(statement: ast.For) -> int | None:
    """The turns of a short loop over a range of literals, which is written out; None for any other loop.

    Only a loop that takes memory needs it: how much may differ from turn to turn.
    """
    call = statement.iter
    takes = any(isinstance(part, ast.Attribute) and part.attr == "empty" for part in ast.walk(statement))
    if not isinstance(call, ast.Call) or jumps(statement) or not takes:
        return None
    try:
        turns = len(range(*(ast.literal_eval(part) for part in call.args)))
    except (TypeError, ValueError):
        return None
    return turns if turns <= WRITTEN_OUT else None


def jumps(statement: ast.For) -> bool:
    """Whether a loop is left, or a turn of it."""
    return any(isinstance(part, ast.Break | ast.Continue) for part in ast.walk(statement))


def _before(body: Block, after: set[str], lives: Lives) -> set[str]:
    """The names that are read before they are set, from here on; `after` are those of what follows."""
    live = set(after)
    for statement in reversed(body):
        live = _STATEMENTS.get(type(statement), _simple)(statement, live, lives)
    return live


def _simple(statement: ast.stmt, after: set[str], lives: Lives) -> set[str]:
    lives.see(statement, after)
    if isinstance(statement, ast.Return):
        return reads(statement)
    augmented = {statement.target.id} if _adds_to_a_name(statement) else set()  # type: ignore[attr-defined]
    return (after - sets([statement])) | reads(statement) | augmented


def _adds_to_a_name(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.AugAssign) and isinstance(statement.target, ast.Name)


def _branch(statement: ast.stmt, after: set[str], lives: Lives) -> set[str]:
    assert isinstance(statement, ast.If)
    lives.outliving |= sets([*statement.body, *statement.orelse]) & after
    branches = [_before(body, after, lives) for body in (statement.body, statement.orelse)]
    return branches[0] | branches[1] | reads(statement.test)


def _loop(statement: ast.stmt, after: set[str], lives: Lives) -> set[str]:
    assert isinstance(statement, ast.For | ast.While)
    if isinstance(statement, ast.For) and (turns := written_out(statement)) is not None:
        live = _before(statement.orelse, after, lives)
        for _ in range(turns):
            live = _before(statement.body, live, lives) - sets([statement.target])
        return live
    head = reads(statement.iter) if isinstance(statement, ast.For) else reads(statement.test)
    target = sets([statement.target]) if isinstance(statement, ast.For) else set()
    follows = _before(statement.orelse, after, lives) | after
    begin: set[str] = set()
    for _ in range(2):  # what the next turn reads is live at the end of this one
        begin = _before(statement.body, follows | begin | head, lives) - target
    lives.outliving |= sets(statement.body) & (follows | begin | (head if isinstance(statement, ast.While) else set()))
    lives.outliving |= target & follows
    return follows | begin | head


_STATEMENTS = {ast.If: _branch, ast.For: _loop, ast.While: _loop}
