"""What an identification makes of a blind record, against the truth."""

from collections.abc import Mapping

from nassim.identification import ModalFit, UpdateReport


def against_truth(fit: ModalFit, report: UpdateReport, truth: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Fitted parameters by their names in the truth, and their errors in percent and in standard deviations."""
    fitted, std = {}, {}
    for k in range(min(2, len(fit.frequency))):
        names = (f"frequency_{k + 1}_Hz", f"damping_ratio_{k + 1}")
        fitted |= zip(names, (fit.frequency[k], fit.damping_ratio[k]), strict=True)
        std |= zip(names, (fit.frequency_std[k], fit.damping_ratio_std[k]), strict=True)
        for output, unit in (("sensor_voltage", "V_per_V"), ("encoder", "m_per_V")):
            name, row = f"{output}_gain_{k + 1}_{unit}", fit.outputs.index(output)
            fitted[name], std[name] = fit.gains[row, k], fit.gains_std[row, k]
    for change in report.changes[-2:]:  # one actuator, one sensor besides the encoder
        name = f"{change.parameter.partition('_')[0]}_factor"
        fitted[name], std[name] = change.after / change.before, change.std / abs(change.before)
    return {
        "fitted": fitted,
        "errors_in_percent": {name: 100 * (value / truth[name] - 1) for name, value in fitted.items()},
        "errors_over_std": {name: (value - truth[name]) / std[name] for name, value in fitted.items()},
    }
