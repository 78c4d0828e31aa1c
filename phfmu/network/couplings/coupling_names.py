"""Couplings by the names users know, each with a line; imports nothing, so that the command line stays fast."""

COUPLINGS = {
    "auto": "the one that fits the members",
    "monolithic": "one composed model",
    "newton": "members stepped apart, steps repeated until the junctions hold: exact at any step size",
    "anderson": "as newton with one value per step, without the members' sensitivities",
    "gauss-seidel": "each member steps once, one after the other, with the newest outputs of the others",
    "jacobi": "each member steps once, all with the outputs at the start of the step",
}

#: those that take no step back
EXPLICIT = ("gauss-seidel", "jacobi")

#: `Solution.accepted_by` of steps that did not converge and were kept, or taken in parts
KEPT, HALVED = "unconverged", "halved"
