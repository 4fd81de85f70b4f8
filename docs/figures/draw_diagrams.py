"""Draw the diagrams: python docs/figures/draw_diagrams.py

CoPhyNet, alongside, and the way from the configuration to the tables. Lengths are in pixels of a page 700 pixels wide.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

HERE = Path(__file__).parent
WIDTH, DPI = 700, 200
POINTS = 0.72  # per pixel
AB, CD, LEARNED, PLAIN = "#d6e4f5", "#f8e3cf", "#e4dcf3", "#ffffff"
LANES = {"AB": "#f1f6fc", "CD": "#fdf5ec", "grey": "#f4f5f7"}
INK, EDGE, AB_INK, CD_INK = "#1c1f24", "#5b6270", "#1f5fa8", "#a0521c"


@dataclass(frozen=True)
class Box:
    """Corners of a box: from the left and from the top."""

    left: float
    top: float
    right: float
    bottom: float

    @property
    def centre(self) -> tuple[float, float]:
        """Return its centre."""
        return (self.left + self.right) / 2, (self.top + self.bottom) / 2

    def west(self) -> tuple[float, float]:
        """Return the middle of the left edge."""
        return self.left, self.centre[1]

    def east(self) -> tuple[float, float]:
        """Return the middle of the right edge."""
        return self.right, self.centre[1]

    def north(self) -> tuple[float, float]:
        """Return the middle of the upper edge."""
        return self.centre[0], self.top

    def south(self) -> tuple[float, float]:
        """Return the middle of the lower edge."""
        return self.centre[0], self.bottom


class Diagram:
    """A figure of boxes and arrows."""

    def __init__(self, height: float) -> None:
        self.figure = Figure(figsize=(WIDTH / 100, height / 100), dpi=DPI)
        self.axis = self.figure.add_axes((0, 0, 1, 1))
        self.axis.set(xlim=(0, WIDTH), ylim=(height, 0))
        self.axis.set_axis_off()

    def lane(self, box: Box, title: str, color: str, ink: str) -> None:
        """Draw a background with a title at its upper left."""
        self._patch(box, color, edge="none", radius=8)
        self.text((box.left + 10, box.top + 14), title, size=12, color=ink, ha="left", weight="bold")

    def box(self, box: Box, text: str, color: str = PLAIN, size: float = 12, **style: object) -> Box:
        """Draw a box with text, and return it."""
        self._patch(box, color, edge=EDGE, radius=5)
        self.text(box.centre, text, size=size, **style)
        return box

    def text(self, place: tuple[float, float], text: str, size: float = 12, **style: object) -> None:
        """Draw text, by default around a place."""
        style = {"ha": "center", "va": "center", "color": INK, "linespacing": 1.35, **style}
        self.axis.text(*place, text, fontsize=size * POINTS, **style)  # type: ignore[arg-type]

    def arrow(self, *corners: tuple[float, float], color: str = INK) -> None:
        """Draw straight lines from corner to corner, the last one with a head."""
        for start, end in pairwise(corners[:-1]):
            self.axis.plot(*zip(start, end, strict=True), color=color, lw=1.1, solid_capstyle="round")
        style = {"arrowstyle": "-|>", "lw": 1.1, "color": color, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 9}
        self.axis.annotate("", corners[-1], corners[-2], arrowprops=style)

    def chain(self, boxes: Sequence[Box]) -> None:
        """Draw arrows from each box to the next on its right."""
        for first, second in pairwise(boxes):
            self.arrow(first.east(), second.west())

    def _patch(self, box: Box, color: str, edge: str, radius: float) -> None:
        style = f"round,pad=0,rounding_size={radius}"
        size = box.right - box.left, box.bottom - box.top
        self.axis.add_patch(FancyBboxPatch((box.left, box.top), *size, boxstyle=style, fc=color, ec=edge, lw=0.9))


def architecture() -> Figure:
    """Draw CoPhyNet: `cophy.models.cophynet` with the numbers of the paper's equations."""
    diagram = Diagram(500)
    diagram.lane(Box(6, 6, 694, 142), "Estimate the confounders U from AB (paper, Sec. 4.1)", LANES["AB"], AB_INK)
    ab = diagram.box(Box(20, 42, 130, 122), "AB\npositions $o_t^k$ of\nall objects $k$\nin all frames $t$", AB)
    encoder = diagram.box(
        Box(160, 42, 312, 122), "graph convolution\nin every frame\n$\\tilde{o}_t^k$   (Eq. 1)", LEARNED
    )
    memory = diagram.box(Box(342, 42, 494, 122), "GRU $\\phi$ over time,\nper object\n$h_t^k$   (Eq. 2)", LEARNED)
    u = diagram.box(Box(524, 42, 680, 122), "U: a vector per object\n$u^k$ = last state of\nthe GRU", AB)
    diagram.chain([ab, encoder, memory, u])

    diagram.lane(Box(6, 152, 694, 494), "Roll out D from C, step by step (paper, Sec. 4.2)", LANES["CD"], CD_INK)
    start = diagram.box(Box(20, 192, 112, 242), "C\npositions $\\bar{o}_0^k$", CD)
    state = diagram.box(Box(20, 300, 112, 350), "positions\n$\\bar{o}_t^k$", CD)
    joined = diagram.box(Box(140, 300, 222, 350), "$[\\bar{o}_t^k : u^k]$", size=13)
    diagram.arrow(start.south(), state.north())
    diagram.text((72, 271), "$t = 0$", ha="left", size=12)
    diagram.chain([state, joined])
    diagram.arrow(u.south(), (u.centre[0], 178), (joined.centre[0], 178), joined.north(), color=AB_INK)

    stability = diagram.box(Box(250, 222, 372, 276), "graph convolution", LEARNED)
    logit = diagram.box(Box(396, 222, 498, 276), "linear layer\nlogit $s_t^k$", LEARNED)
    gate = diagram.box(Box(522, 222, 664, 276), "gate\n$\\sigma((1 - s_t^k)\\,/\\,\\lambda)$", PLAIN)
    dynamics = diagram.box(Box(250, 374, 372, 428), "graph convolution", LEARNED)
    hidden = diagram.box(Box(396, 374, 498, 428), "GRU $\\psi$ over\nthe steps", LEARNED)
    displacement = diagram.box(Box(522, 374, 664, 428), "linear layer\n$\\Delta_t^k$", LEARNED)
    diagram.text((252, 208), "Is the object stable? (Eq. 5)", ha="left")
    diagram.text((252, 360), "How far does it move? (Eq. 3)", ha="left")
    diagram.chain([stability, logit, gate])
    diagram.chain([dynamics, hidden, displacement])
    for end in (stability, dynamics):
        diagram.arrow(joined.east(), (236, 325), (236, end.centre[1]), end.west())
    equation = "next position   (Eq. 4)\n$\\bar{o}_{t+1}^k = \\bar{o}_t^k$ + gate · $\\Delta_t^k$"
    move = diagram.box(Box(492, 300, 664, 350), equation, CD)
    diagram.arrow(gate.south(), (gate.centre[0], move.top))
    diagram.arrow(displacement.north(), (displacement.centre[0], move.bottom))
    outcome = diagram.box(Box(396, 444, 664, 482), "D: all positions $\\bar{o}_1^k, \\bar{o}_2^k, \\ldots$", CD)
    diagram.arrow(move.east(), (680, 325), (680, 463), outcome.east())
    diagram.arrow(outcome.west(), (66, 463), state.south())
    diagram.text((230, 476), "next step", size=12)
    return diagram.figure


def alongside() -> Figure:
    """Draw alongside: `cophy.models.alongside`."""
    diagram = Diagram(560)
    diagram.lane(Box(6, 6, 694, 168), "Encode AB, frame by frame", LANES["AB"], AB_INK)
    ab = diagram.box(Box(20, 40, 150, 98), "AB\npositions, motions", AB)
    messages = diagram.box(Box(178, 40, 330, 98), "messages of all pairs,\nin every frame", LEARNED)
    memory = diagram.box(Box(358, 40, 480, 98), "GRU over time,\nboth directions", LEARNED)
    history = diagram.box(Box(508, 40, 680, 98), "$h_t$: a vector per\nobject and frame", AB)
    attention = diagram.box(Box(358, 114, 480, 158), "attention over\nall frames", LEARNED)
    pair = diagram.box(Box(508, 114, 680, 158), "$r$: a vector per pair", AB)
    diagram.chain([ab, messages, memory, history])
    diagram.arrow(messages.south(), (messages.centre[0], 136), attention.west())
    diagram.chain([attention, pair])

    diagram.lane(Box(6, 178, 694, 554), "Roll out D from C, next to AB, step by step", LANES["CD"], CD_INK)
    start = diagram.box(Box(20, 222, 150, 280), "C\npositions $o_0$\nmotion $v_0$ from AB", CD, size=11.5)
    state = diagram.box(Box(20, 330, 150, 388), "position $o_t$\nmotion $v_t$", CD)
    diagram.arrow(start.south(), state.north())
    diagram.text((92, 305), "$t = 0$", ha="left")
    objects = "each object: $v_t$, height, walls,\noffset from AB at $t$, motions\nin AB at $t$ and $t + 1$"
    nodes = diagram.box(Box(186, 222, 392, 290), objects)
    pairs = "each pair: distances now and\nin AB, next contact"
    relations = diagram.box(Box(186, 330, 392, 388), pairs)
    for end in (nodes, relations):
        diagram.arrow(state.east(), (168, 359), (168, end.centre[1]), end.west())
    network = diagram.box(Box(432, 244, 536, 366), "messages\nof all pairs,\nthen a GRU\nover the steps", LEARNED)
    for begin in (nodes, relations):
        diagram.arrow(begin.east(), (412, begin.centre[1]), (412, 305), network.west())
    results = "stability $s_t$\nmixtures $m_t, m'_t$\ncorrections $c_t, c'_t$\nshare kept $k_t$\nimpulses $J_t$"
    outputs = diagram.box(Box(564, 244, 680, 366), results, PLAIN)
    diagram.chain([network, outputs])
    for start_line in ([history.east(), (687, 69), (687, 204)], [pair.south(), (pair.centre[0], 204)]):
        diagram.arrow(*start_line, (network.centre[0], 204), network.north(), color=AB_INK)
    diagram.text((network.centre[0] + 8, 228), "$h_{t+1}$, $r$", ha="left", color=AB_INK)
    equations = (
        "$\\Delta_t = m_t$ · (motion in AB now) $+\\ (1 - m_t)\\ (v_t + \\Sigma\\, (1 - \\tau_t) J_t + c_t)$\n"
        "$v_{t+1} = m'_t$ · (motion in AB next) $+\\ (1 - m'_t)\\ (k_t v_t + \\Sigma\\, J_t + c'_t)$\n"
        "$o_{t+1} = o_t + \\sigma((1 - s_t)\\,/\\,\\lambda)\\ \\Delta_t$"
    )
    move = diagram.box(Box(186, 412, 680, 490), equations, CD, size=13)
    diagram.arrow((outputs.centre[0], outputs.bottom), (outputs.centre[0], move.top))
    outcome = diagram.box(Box(412, 508, 680, 544), "D: all positions $o_1, o_2, \\ldots$", CD)
    diagram.arrow((outcome.centre[0], move.bottom), outcome.north())
    diagram.arrow(outcome.west(), (85, 526), state.south())
    diagram.text((250, 539), "next step")
    return diagram.figure


def pipeline() -> Figure:
    """Draw which command reads and writes which files."""
    diagram = Diagram(440)
    diagram.text((92, 18), "configuration", weight="bold", color=EDGE)
    diagram.text((292, 18), "command", weight="bold", color=EDGE)
    diagram.text((546, 18), "files that it writes", weight="bold", color=EDGE)
    groups = "scenario/\nsize/\nsplit/\nmodel/\nablation/\ntrainer/\n…"
    conf = diagram.box(Box(10, 36, 174, 430), "", LANES["grey"])
    diagram.text((92, 62), "conf/", size=14, weight="bold", family="monospace")
    diagram.text((92, 108), "a YAML file\nfor every choice", size=12)
    diagram.text((92, 238), groups, size=12.5, family="monospace", linespacing=1.6)
    diagram.text((92, 378), "change any key\non the command line:\nmodel.hidden_dim=64", size=11.5)
    steps = (
        ("generate.py", "simulate, render", "data/<scenario>/<dataset>/", "shard-*.h5, manifest.json,\nREADME.md"),
        (
            "train.py",
            "train, test",
            "outputs/…/seed0/",
            "checkpoints/best.ckpt, predictions.npz,\nmetrics.json: all scores, with 95 % intervals",
        ),
        ("report.py", "compare runs", "outputs/report/", "tables.md, tables.tex, a CSV per table,\nfigures/"),
    )
    above = None
    for number, (script, action, folder, files) in enumerate(steps):
        top = 36 + 140 * number
        command = diagram.box(Box(212, top, 372, top + 114), "", LEARNED)
        x, y = command.centre
        diagram.text((x, y - 12), script, size=14, weight="bold", family="monospace")
        diagram.text((x, y + 14), action)
        written = diagram.box(Box(410, top, 690, top + 114), "", AB)
        x, y = written.centre
        diagram.text((x, y - 26), folder, size=12.5, weight="bold", family="monospace")
        diagram.text((x, y + 14), files, size=12)
        diagram.arrow((conf.right, y), command.west())
        diagram.chain([command, written])
        if above is not None:
            middle = top - 13
            diagram.arrow(above.south(), (above.centre[0], middle), (command.centre[0], middle), command.north())
        above = written
    return diagram.figure


def figures() -> dict[str, Figure]:
    """Return all diagrams by the names of their files."""
    return {"architecture": architecture(), "architecture_alongside": alongside(), "pipeline": pipeline()}


if __name__ == "__main__":
    for name, figure in figures().items():
        figure.savefig(HERE / f"{name}.png")
