"""Regions of sensorimotor space: which one a situation is in, and how a full one splits.

The trees of all agents share one table of nodes (a struct of arrays); a node is known by its place
in it, a *region* by its number within its agent, in order of birth, the root being 0.

Shapes: `R` nodes, `L` rows of leaves (see `examples`), `F` full regions that split at the same
decision, one an agent at most.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_iac.internal.state import Stateful, reserve
from torch_iac.records import Genealogy
from torch_iac.regions.cuts import Cut

NONE = -1
"""No parent, no split yet, or no cut."""

CUTS = 7
"""How many cuts a bundle holds."""

BYTES = 8
"""Comparisons per bundle: as many as a 64-bit word has bytes; the last one is unused."""

COMPACT_FROM = 4096
"""Drop finished points from this batch size on (on a processor)."""


@dataclass(frozen=True)
class Split:
    """Some regions that have just been split; `F` of them, each of another agent.

    Attributes:
        rows: Shape `(F,)`, the left children's rows, which were their parents'.
        new_rows: Shape `(F,)`, the right children's rows.
        agents: Shape `(F,)`, whose regions they are.
        left_regions: Shape `(F,)`, the left children's numbers; the right ones' are one more.
        n_rows: How many rows there are now, over all agents.
    """

    rows: Tensor
    new_rows: Tensor
    agents: Tensor
    left_regions: Tensor
    n_rows: int


_NODE_COLUMNS = {
    "agent": 0,
    "rows": 0,
    "region": 0,
    "parent": NONE,
    "depth": 0,
    "born_step": 0,
    "split_step": NONE,
    "split_count": 0,
    "cut_dimension": NONE,
    "cut_value": math.nan,
    "_bundle": NONE,
    "_bundle_level": 0,
    "_n_cuts": CUTS,
    "_dimensions": 0,
    "_values": math.inf,
    "_first_exit": 0,
}


class RegionTree(Stateful):
    """The region trees of a population; each agent starts with one region, the whole cube.

    Routing compares a situation with seven cuts at once. Neighbouring cuts of a tree form
    *bundles*, each named by the node at its top: a table holds, for each of the 128 possible
    results of the seven comparisons, the node at which a situation leaves the bundle. A leaf is a
    bundle without cuts that leads to itself.

    Args:
        n_agents: How many agents there are.
        device: Where the trees are kept.

    Attributes:
        n_nodes: How many nodes there are, over all agents.
        n_rows: How many leaves there are, over all agents.
        roots: Shape `(A,)`, the root of each agent.
        rows: Shape `(R,)`, the row of each leaf in the tables of examples and errors. Of all that
            has this shape, only the first `n_nodes` are in use.
        agent: Shape `(R,)`, whose node it is.
        region: Shape `(R,)`, each node's number within its agent.
        parent: Shape `(R,)`, a node; `NONE` for a root.
        depth: Shape `(R,)`, how many cuts separate it from its root.
        born_step: Shape `(R,)`, the decision that made it.
        split_step: Shape `(R,)`, the decision that split it; `NONE` for a leaf.
        split_count: Shape `(R,)`, how many examples it held when it split.
        cut_dimension: Shape `(R,)`, of the situation; `NONE` for a leaf.
        cut_value: Shape `(R,)`, in the unit cube; NaN for a leaf.

    Source: Oudeyer and Kaplan (2004), section 2.1: experts keep the cut values that made them. The
    bundles are this library's.
    """

    saved = ("n_rows", "_n_regions", "_n_bundle_levels")
    tables: ClassVar = {"n_nodes": tuple(_NODE_COLUMNS), "_n_exits": ("_exits",)}

    def __init__(self, n_agents: int, device: torch.device) -> None:
        self.n_nodes = self.n_rows = n_agents
        self.roots = torch.arange(n_agents, device=device)
        self._n_regions = torch.ones_like(self.roots)
        self._n_exits = n_agents
        self._n_bundle_levels = 0

        def column(value: float, dtype: torch.dtype = torch.int64, width: int = 0) -> Tensor:
            shape = (n_agents, width) if width else (n_agents,)
            return torch.full(shape, value, dtype=dtype, device=device)

        self.agent = self.roots.clone()
        self.rows = self.roots.clone()
        self.region = column(0)
        self.parent = column(NONE)
        self.depth = column(0)
        self.born_step = column(0)
        self.split_step = column(NONE)
        self.split_count = column(0)
        self.cut_dimension = column(NONE)
        self.cut_value = column(math.nan, torch.float32)

        self._bundle = self.roots.clone()  # the bundle of which a leaf is an exit
        self._bundle_level = column(0)
        self._n_cuts = column(CUTS)  # of a bundle; a leaf is not one yet, so it counts as full
        self._dimensions = column(0, width=BYTES)
        self._values = column(math.inf, torch.float32, BYTES)  # nothing lies above
        self._first_exit = self.roots.clone()
        self._exits = self.roots.clone()

    def route(self, situations: Tensor) -> Tensor:
        """Return the leaf that holds each situation, as a node.

        Args:
            situations: Shape `(A, C, D)`, in the unit cube.

        Returns:
            Shape `(A, C)`.
        """
        n_agents, n_candidates, situation_dim = situations.shape
        points = situations.reshape(-1, situation_dim)
        nodes = self.roots.repeat_interleave(n_candidates)
        sifts = len(points) >= COMPACT_FROM and points.device.type == "cpu"
        for level in range(self._n_bundle_levels):
            if level and sifts:
                inner = (self.split_step.take(nodes) != NONE).nonzero()[:, 0]
                nodes[inner] = self._leave(nodes.take(inner), points.index_select(0, inner))
            else:
                nodes = self._leave(nodes, points)
        return nodes.view(n_agents, n_candidates)

    def _leave(self, nodes: Tensor, points: Tensor) -> Tensor:
        """Return the nodes at which points `(n, D)` leave the bundles of nodes `(n,)`."""
        coordinates = points.gather(1, self._dimensions.index_select(0, nodes))
        above = coordinates > self._values.index_select(0, nodes)
        return self._exits.take(self._first_exit.take(nodes).add_(_as_number(above)))

    def split(self, nodes: Tensor, cut: Cut, counts: Tensor, step: int) -> Split:
        """Give each of some leaves two children.

        The left child takes over its parent's row; the right one gets a new row.

        Args:
            nodes: Shape `(F,)`, leaves of different agents.
            cut: Their cuts, all found.
            counts: Shape `(F,)`, how many examples each holds.
            step: The decision that makes them split.
        """
        n_split = len(nodes)
        numbers = torch.arange(n_split, device=nodes.device)
        left, new_rows = self.n_nodes + 2 * numbers, self.n_rows + numbers
        self.n_nodes += 2 * n_split
        self.n_rows += n_split
        self._reserve()
        self.split_step[nodes] = step
        self.split_count[nodes] = counts
        self.cut_dimension[nodes] = cut.dimension
        self.cut_value[nodes] = cut.value
        rows, agents = self.rows[nodes], self.agent[nodes]
        left_regions = self._n_regions[agents]
        self._n_regions[agents] += 2

        parents, children = nodes.repeat(2), torch.cat([left, left + 1])
        self.agent[children] = agents.repeat(2)
        self.rows[children] = torch.cat([rows, new_rows])
        self.region[children] = torch.cat([left_regions, left_regions + 1])
        self.parent[children] = parents
        self.depth[children] = self.depth[parents] + 1
        self.born_step[children] = step
        self._tie(nodes, children, cut)
        return Split(rows, new_rows, agents, left_regions, self.n_rows)

    def _tie(self, nodes: Tensor, children: Tensor, cut: Cut) -> None:
        """Add the cuts of nodes `(F,)` to the bundles that led there, or to new ones.

        Args:
            nodes: Shape `(F,)`.
            children: Shape `(2F,)`, the left ones, then the right ones.
            cut: The cuts.
        """
        self._open_bundles(nodes[self._n_cuts[self._bundle[nodes]] == CUTS])
        bundles = self._bundle[nodes]
        numbers = self._n_cuts[bundles]
        self._dimensions[bundles, numbers] = cut.dimension
        self._values[bundles, numbers] = cut.value
        self._n_cuts[bundles] += 1

        ways = torch.arange(2**CUTS, device=nodes.device)
        places = self._first_exit[bundles, None] + ways  # (F, 128)
        exits = self._exits[places]
        new_exits = children[: len(nodes), None] + (ways >> numbers[:, None] & 1)
        self._exits[places] = torch.where(exits == nodes[:, None], new_exits, exits)
        self._bundle[children] = bundles.repeat(2)
        self._first_exit[children] = self._new_exits(children, 1)

    def _open_bundles(self, nodes: Tensor) -> None:
        self._bundle_level[nodes] = self._bundle_level[self._bundle[nodes]] + 1
        self._first_exit[nodes] = self._new_exits(nodes, 2**CUTS)
        self._bundle[nodes] = nodes
        self._n_cuts[nodes] = 0
        if len(nodes):
            deepest = int(self._bundle_level[nodes].max())
            self._n_bundle_levels = max(self._n_bundle_levels, deepest)

    def _new_exits(self, nodes: Tensor, n_exits: int) -> Tensor:
        """Return where `n_exits` exits of each node begin; they all lead to the node itself."""
        firsts = self._n_exits + n_exits * torch.arange(len(nodes), device=nodes.device)
        self._n_exits += n_exits * len(nodes)
        self._exits = reserve(self._exits, self._n_exits)
        self._exits[firsts[:, None] + torch.arange(n_exits, device=nodes.device)] = nodes[:, None]
        return firsts

    def leaves(self) -> Tensor:
        """Return the nodes that are leaves, by agent, then region, shape `(leaves,)`."""
        nodes = self._in_order()
        return nodes[self.split_step[nodes] == NONE]

    def boxes(self, situation_dim: int) -> tuple[Tensor, Tensor]:
        """Return the bounds of every node, low and high, each `(R, D)`, in the unit cube.

        A situation is in the box if it is above low and at most high; at low 0, 0 belongs to it.
        """
        lows = torch.zeros(self.n_nodes, situation_dim, device=self.roots.device)
        highs = torch.ones_like(lows)
        for depth in range(1, int(self.depth.max()) + 1):
            nodes = (self.depth[: self.n_nodes] == depth).nonzero()[:, 0]
            parents = self.parent[nodes]
            lows[nodes], highs[nodes] = lows[parents], highs[parents]
            # Of two siblings, born one after the other, the second is the right one.
            is_right = self.parent[nodes - 1] == parents
            for bounds, side in ((lows, is_right), (highs, ~is_right)):
                cut = parents[side]
                bounds[nodes[side], self.cut_dimension[cut]] = self.cut_value[cut]
        return lows, highs

    def genealogy(self, counts: Tensor) -> Genealogy:
        """Return every region ever made.

        Args:
            counts: Shape `(L,)`, how many examples each row holds.
        """
        nodes = self._in_order()
        parents = self.parent[nodes]
        is_leaf = self.split_step[nodes] == NONE
        columns = Genealogy(
            agent=self.agent[nodes],
            region=self.region[nodes],
            parent=torch.where(parents == NONE, NONE, self.region[parents]),
            depth=self.depth[nodes],
            born_step=self.born_step[nodes],
            split_step=self.split_step[nodes],
            cut_dimension=self.cut_dimension[nodes],
            cut_value=self.cut_value[nodes],
            n_examples=torch.where(is_leaf, counts[self.rows[nodes]], self.split_count[nodes]),
        )
        return Genealogy(**{name: column.cpu() for name, column in vars(columns).items()})

    def _in_order(self) -> Tensor:
        # Nodes are in order of birth: a stable sort by agent keeps each agent's regions in order.
        return self.agent[: self.n_nodes].sort(stable=True).indices

    def _reserve(self) -> None:
        for name, fill in _NODE_COLUMNS.items():
            setattr(self, name, reserve(getattr(self, name), self.n_nodes, fill))


def _as_number(bits: Tensor) -> Tensor:
    """Return the numbers `(n,)` whose binary digits are `bits`, bool, shape `(n, 8)`, lowest first.

    The multiplication moves the eight bytes of 0 or 1 side by side into the highest byte. Its own
    highest digit, which would be the sign, is always 0.
    """
    return bits.view(torch.int64).view(-1) * 0x0102040810204080 >> 56
