"""The structure of a space that hunts use: its units, its blocks that may be dormant, and kinds of thresholds."""

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from brink.search.features import Unit, units_of
from brink.search.parameters import Categorical, Dormant
from brink.search.space import BoolArray, FloatArray, SearchSpace, frozen_array

Kind: TypeAlias = tuple[float, ...]
"""What thresholds are told apart by first; equal kinds are equal tuples."""


@dataclass(frozen=True, slots=True)
class Block:
    """Numbers that are dormant while a label has its null choice, such as those of an error.

    Attributes:
        label: Column of the label.
        null: Index of its null choice.
        columns: Columns of the label, the numbers, and what else belongs to the same interchangeable part.
        part: Equal for blocks that are interchangeable, otherwise their own.
    """

    label: int
    null: int
    columns: tuple[int, ...]
    part: int


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """The parts of a space.

    Attributes:
        space: The space.
        units: Its units.
        numeric: Indices of the units that are numbers and not fixed by an ODD.
        categories: Indices of the other units that are not fixed.
        blocks: Its blocks.
        scene: Columns of the categories outside blocks that tell kinds apart.
    """

    space: SearchSpace
    units: tuple[Unit, ...] = field(init=False)
    numeric: tuple[int, ...] = field(init=False)
    categories: tuple[int, ...] = field(init=False)
    blocks: tuple[Block, ...] = field(init=False)
    scene: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        units, parameters = units_of(self.space), self.space.parameters
        numeric, categories = [], []
        for index, unit in enumerate(units):
            first = parameters[unit[0]]
            if isinstance(first, Categorical):
                categories += [index] if len(first.codes) > 1 else []
            elif any(
                not isinstance(p, Categorical) and p.least < p.most
                for p in (parameters[column] for column in unit)
            ):
                numeric.append(index)
        object.__setattr__(self, "units", units)
        object.__setattr__(self, "numeric", tuple(numeric))
        object.__setattr__(self, "categories", tuple(categories))
        object.__setattr__(self, "blocks", tuple(_blocks_of(self.space)))
        scene = (c for c, p in enumerate(parameters) if isinstance(p, Categorical) and p.tells_kinds)
        object.__setattr__(self, "scene", tuple(scene))

    def active(self, row: FloatArray) -> list[int]:
        """Return the indices of the blocks of a solution that are not dormant."""
        return [place for place, block in enumerate(self.blocks) if row[block.label] != block.null]

    def without(self, row: FloatArray, blocks: list[int]) -> FloatArray | None:
        """Return a solution with some blocks dormant; None if an ODD or a constraint does not allow that."""
        changed = np.array(row)
        for place in blocks:
            changed[self.blocks[place].label] = self.blocks[place].null
        rng = np.random.Generator(np.random.PCG64(0))  # not drawn from: no number is missing
        repaired = self.space.repaired_parts(changed, [self.blocks[place].label for place in blocks], rng)
        is_as_wanted = all(repaired[self.blocks[p].label] == self.blocks[p].null for p in blocks)
        return frozen_array(repaired) if is_as_wanted else None

    def block_of(self, unit: int) -> int:
        """Return the index of the block that a unit belongs to, -1 for none."""
        column = self.units[unit][0]
        return next((place for place, block in enumerate(self.blocks) if column in block.columns), -1)

    def block_kind(self, row: FloatArray, block: int) -> Kind:
        """Return the kind of a block's content: its categories, whichever of its equals it is in, and the scene."""
        return (
            float(self.blocks[block].part),
            *(float(row[column]) for column in (*self.choices(block), *self.scene)),
        )

    def choices(self, block: int) -> list[int]:
        """Return the columns of the categories of a block."""
        return [column for column in self.blocks[block].columns if self.space.categorical[column]]

    def count_contents(self) -> int:
        """Return how many kinds of contents the blocks can have; interchangeable ones count once."""
        codes = [len(p.codes) if isinstance(p, Categorical) else 1 for p in self.space.parameters]
        by_part = {
            block.part: math.prod(
                codes[column] - (column == block.label) for column in (*self.choices(index), *self.scene)
            )
            for index, block in enumerate(self.blocks)
        }
        return sum(by_part.values())

    def kind(self, row: FloatArray, unit: int) -> Kind:
        """Return the kind of a threshold: which number, in a block with which categories."""
        block = self.block_of(unit)
        if block < 0:
            return (-1.0, float(unit), *(float(row[column]) for column in self.scene))
        position = self.blocks[block].columns.index(self.units[unit][0])
        return (float(position), *self.block_kind(row, block))

    def movable(self, row: FloatArray) -> list[int]:
        """Return the indices of the units that can be moved: the numbers, or without any, the categories."""
        dormant = self.space.dormant(row)
        numbers = [index for index in self.numeric if not dormant[list(self.units[index])].any()]
        return numbers or list(self.categories)


def _blocks_of(space: SearchSpace) -> list[Block]:
    blocks = []
    for component, part in zip(space.components, space.slices, strict=True):
        column = {parameter.name: part.start + place for place, parameter in enumerate(component.parameters)}
        for rule in component.constraints:
            if not isinstance(rule, Dormant):
                continue
            label = component.by_name[rule.label]
            assert isinstance(label, Categorical)
            null = label.choices.index(rule.null_choice)
            equals = [names for names in component.interchangeable if rule.label in names]
            names = equals[0] if equals else (rule.label, *rule.members)
            first = component.interchangeable[0][0] if equals else rule.label
            if null in label.codes and len(label.codes) > 1:
                columns = tuple(column[name] for name in names)
                blocks.append(Block(column[rule.label], null, columns, column[first]))
    return blocks


def free_columns(space: SearchSpace) -> BoolArray:
    """Return which columns an ODD does not fix, shape ``(d,)``."""
    return np.array(
        [len(p.codes) > 1 if isinstance(p, Categorical) else p.least < p.most for p in space.parameters],
        np.bool_,
    )
