"""Calibration: models in closed form, what data can determine, and the APA300ML's record."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import meshed

from models.apa300ml import (
    CALIBRATION,
    PAPER_FREQUENCY_FE,
    PORTS,
    PZT,
    PZT_TABLE_1,
    STACK,
    VENDOR_STIFFNESS,
    calibration as apa_calibration,
    make_apa300ml,
    reduced_apa300ml,
)
from models.apa300ml.beam_model import axial_stiffness, beam_model
from models.apa300ml.calibration import (
    CIRCUITS,
    PARAMETERS,
    data_sheet_figures,
    figures_with_5kg,
    make_default,
    make_model,
    variant,
)
from models.bench import BENCH_CONDITIONS
from nassim import craig_bampton
from nassim.fem.assembly import assemble_mesh, mesh_and_solid
from nassim.identification import Calibration, Parameter, Target, at_bounds, calibrate, check_determined, sensitivities

WIDTH = Parameter("width", 0.010, 0.005, 0.020)
HEIGHT = Parameter("height", 0.005, 0.002, 0.010)
MODULUS = Parameter("modulus", 200e9, 100e9, 300e9)


def cantilever(values):
    """A beam of 0.1 m by Euler and Bernoulli: stiffness at its tip, first frequency, mass."""
    width, height, modulus = values["width"], values["height"], values.get("modulus", 200e9)
    area, inertia = width * height, width * height**3 / 12
    frequency = 1.8751**2 / (2 * np.pi * 0.1**2) * np.sqrt(modulus * inertia / (7800.0 * area))
    return {"stiffness": 3 * modulus * inertia / 0.1**3, "frequency": frequency, "mass": 7800.0 * area * 0.1}


def test_sensitivities_are_the_exponents():
    found = sensitivities(cantilever, [WIDTH, HEIGHT, MODULUS], ["stiffness", "frequency", "mass"])
    assert np.allclose(found, [[1, 3, 1], [0, 1, 0.5], [1, 1, 0]], atol=1e-9)


def test_sensitivity_at_a_bound():
    edge = Parameter("height", 0.010, 0.002, 0.010)
    assert np.allclose(sensitivities(cantilever, [WIDTH, edge], ["stiffness"]), [[1, 3]])


@pytest.mark.parametrize("width", [0.012, WIDTH.start])
def test_fit_finds_the_truth_with_poor_sensitivities(width):
    """Where one parameter is right from the start, the other is still fitted."""
    truth = {"width": width, "height": 0.0065}
    targets = [Target(name, value, 0.01) for name, value in cantilever(truth).items() if name != "mass"]
    exact = np.array([[1.0, 3.0], [0.0, 1.0]])
    lines = []
    result = calibrate(cantilever, [WIDTH, HEIGHT], targets, sensitivity=exact * [1.1, 0.9], report=lines.append)
    for name, value in truth.items():
        assert result.values[name] == pytest.approx(value, rel=1e-3)
    assert result.n_evaluations == len(lines) > 2
    assert result.figures["mass"] == pytest.approx(cantilever(truth)["mass"], rel=2e-3), "not fitted, so a prediction"


def test_a_prediction_is_as_uncertain_as_what_it_follows_from():
    """The mass is the stiffness over the square of the frequency, so that its deviation is known by hand."""
    figures = cantilever({"width": 0.012, "height": 0.0065})
    targets = [Target("stiffness", figures["stiffness"], 0.01), Target("frequency", figures["frequency"], 0.02)]
    parameters = [WIDTH, HEIGHT]
    found = calibrate(cantilever, parameters, targets, sensitivity=[[1, 3], [0, 1]])
    s = sensitivities(cantilever, parameters, ["mass"])[0]
    assert np.sqrt(s @ found.covariance @ s) == pytest.approx(np.hypot(0.01, 2 * 0.02), rel=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), list(found.deviations.values()))
    assert "height = 0.0065 ± 2 %" in str(found)
    of_nassim_0_2 = Calibration(found.values, found.deviations, found.figures, found.errors, 2)
    assert of_nassim_0_2.covariance is None
    assert str(of_nassim_0_2) == str(found)


def test_deviations_follow_from_the_tolerances():
    def beam(values):
        return cantilever({"width": 0.01} | dict(values))

    target = Target("stiffness", beam({"height": 0.005})["stiffness"], 0.03)
    result = calibrate(beam, [HEIGHT], [target], sensitivity=[[3.0]])
    assert result.deviations["height"] == pytest.approx(0.01)
    assert result.errors["stiffness"] == pytest.approx(0.0, abs=1e-9)


def test_figures_that_contradict_each_other_are_met_half_way():
    """Two figures of one length: their weighted mean in logarithms, too large for the lesser of them."""
    targets = [Target("by_tape", 0.100, 0.01), Target("by_laser", 0.101, 0.005)]
    rod = Parameter("length", 0.1, 0.05, 0.2)
    found = calibrate(lambda p: dict.fromkeys(("by_tape", "by_laser"), p["length"]), [rod], targets,
                      sensitivity=[[1.0], [1.0]], report=(lines := []).append)  # fmt: skip
    expected = 0.100 * 1.01 ** (4 / 5)
    assert found.values["length"] == pytest.approx(expected, rel=1e-9)
    assert found.deviations["length"] == pytest.approx(1 / np.hypot(1 / 0.01, 1 / 0.005))
    assert found.errors == pytest.approx({"by_tape": expected / 0.100 - 1, "by_laser": expected / 0.101 - 1}, rel=1e-6)
    assert lines[-1] == "by_tape +0.799 %; by_laser -0.199 %"
    told = [
        f"{name}: {expected:.5g}, {off} % from its target" for name, off in (("by_tape", "+0.8"), ("by_laser", "-0.2"))
    ]
    assert str(found).splitlines()[1:] == told


def test_what_was_not_fitted_moves_what_was():
    """Stiffness goes with modulus, width and height cubed, so the modulus with their inverses: exact, not linear."""
    target = Target("stiffness", 1.3 * cantilever({"width": 0.010, "height": 0.005})["stiffness"], 0.01)
    near = Parameter("height", 0.005, 0.0045, 0.006)
    calls = []
    moved = at_bounds(
        cantilever, [MODULUS], [WIDTH, near], [target], sensitivity=[[1.0]], advance=lambda: calls.append(1)
    )
    assert moved["width"]["modulus"] == pytest.approx((0.010 / 0.005 - 1, 0.010 / 0.020 - 1), rel=1e-3)
    assert moved["height"]["modulus"] == pytest.approx(((5 / 4.5) ** 3 - 1, (5 / 6) ** 3 - 1), rel=1e-3)
    assert len(calls) == 4
    with pytest.raises(ValueError, match="would need modulus"):
        at_bounds(cantilever, [MODULUS], [WIDTH, HEIGHT], [target], sensitivity=[[1.0]])


def width_to_itself(values):
    return {"width": values["width"]}


def fit_width(gap, **options):
    """Fit a width that is off by a gap in its logarithm to a target of one per cent."""
    target = Target("width", WIDTH.start * np.exp(gap), 0.01)
    return calibrate(width_to_itself, [WIDTH], [target], **options)


def test_a_fit_has_converged_within_a_fiftieth_of_a_deviation():
    assert fit_width(0.9 * 0.02 * 0.01, sensitivity=[[1.0]]).n_evaluations == 1
    assert fit_width(1.1 * 0.02 * 0.01, sensitivity=[[1.0]]).n_evaluations == 2


def chain_frequencies(values):
    """Three masses in line on three springs, by their eigenproblem."""
    k = [values[f"k{n}"] for n in (1, 2, 3)]
    stiffness = np.array([[k[0] + k[1], -k[1], 0], [-k[1], k[1] + k[2], -k[2]], [0, -k[2], k[2]]])
    root = np.diag(1 / np.sqrt([8.0, 3.0, 1.5]))
    return {f"f{n}": f for n, f in enumerate(np.sqrt(np.linalg.eigvalsh(root @ stiffness @ root)))}


def test_sensitivities_of_the_model_are_renewed_at_each_step():
    """Those of the start would lead away from springs that are ten per cent off."""
    truth = {"k1": 2.2e6, "k2": 1.35e6, "k3": 0.8e6}
    parameters = [Parameter(n, k, 0.5e6, 5e6) for n, k in (("k1", 2e6), ("k2", 1.5e6), ("k3", 0.9e6))]
    targets = [Target(name, value, 1e-4) for name, value in chain_frequencies(truth).items()]
    found = calibrate(chain_frequencies, parameters, targets)
    assert found.values == pytest.approx(truth, rel=1e-4)
    at_the_end = [replace(p, start=truth[p.name]) for p in parameters]
    deviations = 1e-4 * np.linalg.norm(
        np.linalg.inv(sensitivities(chain_frequencies, at_the_end, [t.name for t in targets])), axis=1
    )
    np.testing.assert_allclose(list(found.deviations.values()), deviations, rtol=1e-3)


def test_a_fit_may_take_eight_steps():
    """With twice the true sensitivity, each step leaves a half."""
    assert fit_width(0.9 * 2**7 * 0.02 * 0.01, sensitivity=[[2.0]]).n_evaluations == 8
    with pytest.raises(RuntimeError, match="has not converged after 8 steps"):
        fit_width(1.1 * 2**7 * 0.02 * 0.01, sensitivity=[[2.0]])


@pytest.mark.parametrize("sign", [-1, 1])
def test_parameters_move_by_up_to_a_factor_of_five_with_others_at_their_bounds(sign):
    target = Target("area", 1.0, 0.01)

    def moved(share):
        other = Parameter("height", 1.0, *sorted((1.0, (5 * share) ** sign)))
        free = [Parameter("width", 1.0, 0.9, 1.1)]
        model = lambda values: {"area": values["width"] * values["height"]}  # noqa: E731
        return at_bounds(model, free, [other], [target], sensitivity=[[1.0]])["height"]["width"]

    assert moved(0.9) == pytest.approx(((4.5 - 1, 0.0) if sign < 0 else (0.0, 1 / 4.5 - 1)), abs=1e-9)
    with pytest.raises(ValueError, match="would need width"):
        moved(1.1)


def test_more_parameters_than_figures():
    with pytest.raises(ValueError, match=r"2 parameters cannot be fitted to 1 figure.*alone.*: width, height"):
        calibrate(cantilever, [WIDTH, HEIGHT], [Target("stiffness", 1e4, 0.01)], sensitivity=[[1.0, 3.0]])


def test_parameters_that_the_figures_cannot_tell_apart():
    calls = []
    targets = [Target("stiffness", 1e5, 0.01), Target("mass", 0.04, 0.01)]
    with pytest.raises(ValueError, match=r"cannot determine a \(only to .* changing a by -?\+?100 % and b by"):
        calibrate(
            calls.append,
            [Parameter("a", 1.0, 0.1, 10.0), Parameter("b", 1.0, 0.1, 10.0)],
            targets,
            sensitivity=[[1.0, 1.0], [1.0, 1.01]],
        )
    assert not calls, "refused before any long work"


@pytest.mark.parametrize("share", [0.9, 1.1])
@pytest.mark.parametrize("options", [{}, {"largest_deviation": 0.02}])
def test_the_largest_deviation_of_a_parameter(options, share):
    """One figure in proportion to the parameter: its tolerance is the parameter's deviation."""
    target = Target("mass", 0.05, share * options.get("largest_deviation", 0.1))

    def model(values):
        return {"mass": 5.0 * values["width"]}

    fit = functools.partial(calibrate, model, [WIDTH], [target], sensitivity=[[1.0]], **options)
    if share > 1:
        with pytest.raises(ValueError, match="cannot determine width"):
            fit()
    else:
        assert fit().deviations == {"width": pytest.approx(target.tolerance)}


def test_progress_is_told_once_per_evaluation():
    told = []
    sensitivities(cantilever, [WIDTH, HEIGHT], ["mass"], advance=lambda *_: told.append(1))
    assert len(told) == 4


def test_figures_that_do_not_depend_on_the_parameter():
    with pytest.raises(ValueError, match=r"cannot determine modulus .*none of them"):
        calibrate(cantilever, [MODULUS], [Target("mass", 0.04, 0.01)], sensitivity=[[0.0]])


def test_targets_out_of_reach():
    with pytest.raises(ValueError, match=r"would need height = .*, outside 0.002 to 0.01"):
        calibrate(
            lambda values: cantilever({"width": 0.01} | dict(values)),
            [HEIGHT],
            [Target("frequency", 5e4, 0.01)],
            sensitivity=[[1.0]],
        )


def test_unknown_figures_and_bad_numbers():
    with pytest.raises(ValueError, match="does not give colour; it gives stiffness"):
        sensitivities(cantilever, [WIDTH, HEIGHT], ["colour"])
    for nothing in (
        lambda: sensitivities(cantilever, [], ["mass"]),
        lambda: calibrate(cantilever, [], [], sensitivity=[]),
    ):
        with pytest.raises(ValueError, match="name at least one parameter"):
            nothing()
    mass, column = Target("mass", 0.4, 0.01), [[1.0], [1.0]]
    for twice, kind in (
        (lambda: sensitivities(cantilever, [WIDTH, WIDTH], ["mass"]), "parameter names must differ.*: width"),
        (lambda: calibrate(cantilever, [WIDTH, WIDTH], [mass], sensitivity=[[1.0, 1.0]]), "parameter names.*: width"),
        (lambda: calibrate(cantilever, [WIDTH], [mass, mass], sensitivity=column), "target names must differ.*: mass"),
        (lambda: at_bounds(cantilever, [WIDTH], [HEIGHT, WIDTH], [mass], sensitivity=[[1.0]]), "names.*: width"),
    ):
        with pytest.raises(ValueError, match=kind):
            twice()
    for check in (calibrate, check_determined):
        given = (cantilever,) * (check is calibrate)
        with pytest.raises(ValueError, match="sensitivity must have shape 1 x 2, got 1 x 1"):
            check(*given, [WIDTH, HEIGHT], [mass], sensitivity=[[1.0]], largest_deviation=1.0)
    with pytest.raises(ValueError, match=r"'width' has no room between its bounds: 0.01 to 0.01"):
        sensitivities(cantilever, [Parameter("width", 0.01, 0.01, 0.01), HEIGHT], ["mass"])
    with pytest.raises(ValueError, match="does not lie between"):
        Parameter("width", 1.0, 2.0, 3.0)
    for lowest in (0.0, -1.0):  # parameters change by factors
        with pytest.raises(ValueError, match="width: lowest must be positive"):
            Parameter("width", 1.0, lowest, 3.0)
    with pytest.raises(ValueError, match="value must be positive"):
        Target("stiffness", -1.0, 0.01)
    for tolerance in (0.0, -0.01):  # which would weigh a figure infinitely, or as much as its positive value does
        with pytest.raises(ValueError, match="'stiffness': tolerance must be positive"):
            Target("stiffness", 1.0, tolerance)
    with pytest.raises(ValueError, match="NaN"):
        sensitivities(lambda _: {"stiffness": np.nan}, [WIDTH], ["stiffness"])


@pytest.mark.slow
def test_a_changed_ceramic_keeps_the_mesh():
    """Two moduli on one mesh and a mesh of its own: the first differ smoothly, so differences mean something."""
    with pytest.raises(TypeError, match="elment_size"):  # before any geometry is made
        make_model(elment_size=12e-3)
    model = make_model(element_size=12e-3, order=1)
    stiffnesses = [model({"pzt_modulus": e})["axial_stiffness"] for e in (48e9, 49e9, 50e9)]
    assert abs(stiffnesses[0] - 2 * stiffnesses[1] + stiffnesses[2]) < 0.02 * (stiffnesses[2] - stiffnesses[0])
    assert variant({"arm_thickness": 1.5e-3}).materials["sensor_stack"].young_modulus == PARAMETERS["pzt_modulus"].start


@pytest.fixture(scope="module")
def coarse_figures(apa_model):
    """The APA with the calibrated ceramic and with Table 1's, on the coarse mesh of other tests."""
    mesh, _ = mesh_and_solid(apa_model)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(apa_calibration, "build_fe_model", lambda solid, progress: assemble_mesh(mesh, solid, 2))
        model = make_model()
        return [model({"pzt_modulus": ceramic.young_modulus}) for ceramic in (PZT, PZT_TABLE_1)]


def test_calibration_takes_off_what_the_record_says(coarse_figures):
    """Table 1's ceramic, not calibrated, is 1.2 % too stiff: by the recorded sensitivity, and on a mesh of its own."""
    record = json.loads(CALIBRATION.read_text())
    ratio = PZT_TABLE_1.young_modulus / PZT.young_modulus
    for figure in ("axial_stiffness", "frequency_5kg", "stroke"):
        with_record, without = (figures[figure] for figures in coarse_figures)
        exponent = record["sensitivities"][figure]["pzt_modulus"]
        assert np.log(without / with_record) / np.log(ratio) == pytest.approx(exponent, abs=0.02), figure
    not_calibrated = (
        record["figures"]["axial_stiffness"] * ratio ** record["sensitivities"]["axial_stiffness"]["pzt_modulus"]
    )
    assert 1.005 < not_calibrated / VENDOR_STIFFNESS < 1.02


def test_the_frequency_follows_from_the_stiffness(coarse_figures):
    """sqrt(k / m) / 2 pi: with either ceramic the same mass moves, so the frequency confirms nothing more."""
    moving = [f["axial_stiffness"] / (2 * np.pi * f["frequency_5kg"]) ** 2 for f in coarse_figures]
    assert moving[0] == pytest.approx(moving[1], rel=1e-4)
    assert 5.0 < moving[0] < 5.0 + 0.5 * coarse_figures[0]["mass"]
    sensitivity = json.loads(CALIBRATION.read_text())["sensitivities"]
    for parameter in PARAMETERS:
        half = 0.5 * sensitivity["axial_stiffness"][parameter]
        assert sensitivity["frequency_5kg"][parameter] == pytest.approx(half, abs=2e-3)


def test_the_record_tells_the_spread_that_geometry_causes():
    """Hidden geometry moves the modulus much more than the vendor's tolerance does, and to both sides."""
    record = json.loads(CALIBRATION.read_text())
    spread = record["relative_changes_with_others_at_their_bounds"]
    assert spread["command"] == "python scripts/calibrate_apa.py"
    sensitivity = record["sensitivities"]["axial_stiffness"]
    for name in ("arm_thickness", "pad_fillet", "relief"):
        parameter = PARAMETERS[name]
        assert spread[name]["bounds"] == [parameter.lowest, parameter.highest]
        for bound, change in zip(spread[name]["bounds"], spread[name]["pzt_modulus"], strict=True):
            linear = -sensitivity[name] / sensitivity["pzt_modulus"] * np.log(bound / parameter.start)
            assert np.sign(np.log1p(change)) == np.sign(linear) or bound == parameter.start
            assert abs(np.log1p(change)) < 2 * abs(linear) + 1e-3
    assert max(spread["relief"]["pzt_modulus"]) > 5 * record["relative_deviations"]["pzt_modulus"]


@pytest.mark.slow
def test_calibrated_apa_on_its_default_mesh(apa_prisms):
    """Stiffness as fitted; of what was not, the first frequency clamped at the bottom does not follow from it."""
    record = json.loads(CALIBRATION.read_text())
    assert PZT.young_modulus == record["parameters"]["pzt_modulus"]
    apa = reduced_apa300ml(ports=PORTS, progress=False)  # that of other tests
    stiffness = 1 / apa.compliance(fixed=["bottom"])[8, 8]
    assert stiffness == pytest.approx(VENDOR_STIFFNESS, rel=5e-3)
    assert stiffness == pytest.approx(record["figures"]["axial_stiffness"], rel=1e-3)
    frequency = apa.eigenfrequencies(**BENCH_CONDITIONS, masses={"top": 5.0})[0]
    assert frequency == pytest.approx(PAPER_FREQUENCY_FE, rel=0.015)
    assert frequency == pytest.approx(record["figures"]["frequency_5kg"], rel=1e-3)
    assert apa.eigenfrequencies(fixed=["bottom"])[0] == pytest.approx(record["figures"]["blocked_1"], rel=1e-3)
    table_1 = craig_bampton(meshed(apa_prisms, make_apa300ml(ceramic=PZT_TABLE_1), 3), n_modes=0, progress=False)
    not_calibrated = 1 / table_1.compliance(fixed=["bottom"])[8, 8]
    assert 1.01 < not_calibrated / stiffness < 1.015


@pytest.mark.slow
def test_open_stacks_are_stiffer_by_what_the_beam_model_says(apa_tetrahedra):
    """All three stacks open: each is 1 / (1 - k33^2) as stiff; the rest of the actuator stays as it is."""
    fe_model = meshed(apa_tetrahedra, variant({}), 2)
    figures = {circuit: data_sheet_figures(fe_model, circuit=circuit) for circuit in CIRCUITS}
    beam = beam_model()
    opened = beam.span / (1 - STACK.stroke_per_volt**2 * beam.span / STACK.capacitance)
    line = 1 / (1 / beam.line - 3 / beam.span + 3 / opened)
    expected = axial_stiffness(beam, line=line) / axial_stiffness(beam) - 1
    found = figures["open"]["axial_stiffness"] / figures["shorted"]["axial_stiffness"] - 1
    assert found == pytest.approx(expected, rel=0.2)
    assert figures["open"]["stroke"] == pytest.approx(figures["shorted"]["stroke"], rel=1e-8)
    with pytest.raises(ValueError, match="unknown circuit 'closed'; known: shorted, open"):
        data_sheet_figures(fe_model, circuit="closed")


def test_figures_with_5kg_by_hand():
    """A spring with 5 kg and 30 g of its own."""
    frequency = np.sqrt(1.8e6 / 5.03) / (2 * np.pi)
    found = figures_with_5kg({"axial_stiffness": 1.8e6, "frequency_5kg": frequency})
    assert found["moving_mass_kg"] == pytest.approx(5.03)
    implied = 5.03 * (2 * np.pi * 95.9) ** 2
    assert found["stiffness_of_the_papers_frequency_N_per_m"] == pytest.approx(implied)
    assert found["stiffness_of_the_papers_frequency_over_vendors_percent"] == pytest.approx(
        100 * (implied / 1.79e6 - 1)
    )


@pytest.mark.parametrize(("options", "circuit"), [({}, "shorted"), ({"circuit": "open"}, "open")])
def test_figures_are_those_of_the_circuit_and_the_mesh_that_are_told(options, circuit, monkeypatch):
    for name, replaced in {
        "variant": lambda values: None,
        "build_fe_model": lambda solid, *, progress, order: order,
        "replace_materials": lambda model, materials: model,
        "data_sheet_figures": lambda model, *, circuit: (model, circuit),
    }.items():
        monkeypatch.setattr(apa_calibration, name, replaced)
    assert make_model(order=2, **options)({}) == (2, circuit)


def test_a_fit_becomes_the_default(tmp_path, monkeypatch):
    monkeypatch.setattr(apa_calibration, "CALIBRATION", tmp_path / "calibration.json")
    make_default({"parameters": {"pzt_modulus": 48e9}})
    assert json.loads((tmp_path / "calibration.json").read_text()) == {"parameters": {"pzt_modulus": 48e9}}


def test_a_fit_that_targets_cannot_determine_is_refused_before_the_fine_mesh(monkeypatch):
    def model(**mesh):
        assert mesh["order"] == 2, "only the coarse mesh is needed to see it"
        return lambda values: {name: values["pzt_modulus"] ** 0.01 for name in apa_calibration.FIGURES}

    monkeypatch.setattr(apa_calibration, "make_model", model)
    with pytest.raises(ValueError, match="pzt_modulus"):
        apa_calibration.fit(["pzt_modulus"], [Target("stroke", 3e-4, 0.01)])
