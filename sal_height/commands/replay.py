"""`sal-height replay`: process a recorded bag again and compare the heights."""

from __future__ import annotations

from sal_height.commands._options import (
    INTERRUPTED,
    PROCESSING,
    Bag,
    Estimators,
    NodeParameters,
    OutputFolder,
    bag_name,
    command,
    node_parameters,
    output_folder,
)

EXAMPLES = """
  sal-height replay out/sal_spotlight/bag
  sal-height replay out/sal_spotlight/bag --param ml_height.objective=numerator
  sal-height replay out/sal_spotlight/bag --estimators ml,capon
  sal-height replay out/sal_spotlight/bag \\
    --param sar_compression.calibration=out/calibrated/calibration.npz
"""

app = command(
    "replay",
    PROCESSING,
    EXAMPLES,
    "heights differ from the recorded ones, are missing or extra, and no --param was given",
)


@app.default
def replay(bag: Bag, /, *, out: OutputFolder = None, param: NodeParameters = (), estimators: Estimators = ()) -> int:
    """Play a recorded bag through the same nodes and compare the heights with those recorded.

    The output folder holds the new bag and report.json. A bag with one detector
    is focused only; its images are recorded, drawn and measured. Without
    --estimators, heights are made by those that made the recorded ones.

    Args:
        out: Output folder, new or empty. Default: out/replay_BAG, or the next free of out/replay_BAG_2, ….
    """
    from sal_height.runs.replay import replay as play_again

    folder = output_folder(out, f"replay_{bag_name(bag)}")
    outcome, compared = play_again(bag, folder, node_parameters(param), estimators=estimators)
    for topic, result in compared.items():
        verdict = "equal to the recorded ones, value for value" if result.equal else f"different: {result}"
        print(f"{topic}: {result.matched} height images, {verdict}")
    print(f"{'interrupted; ' if outcome.interrupted else ''}see {folder}/report.json and {folder}/bag")
    if outcome.interrupted:
        return INTERRUPTED
    return int(not param and not all(result.equal for result in compared.values()))
