"""An insertion as a recording: what is in it, what it exports to, and the loop on it again."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from needleplan.control import (
    Insertion,
    InsertionOutcome,
    InsertionReport,
    RunEvent,
    RunEventName,
    RunRecorder,
    RunSetup,
    replay,
)
from needleplan.devices import Sample, Source, VirtualClock
from needleplan.errors import DataError
from needleplan.estimation.registration import Registration, RegistrationVerdict, VerdictStatus
from needleplan.estimation.tip import TipSettings
from needleplan.models import Torsion
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.models.tissue import NeedlePush, TargetPush
from needleplan.planning import plan
from needleplan.recording import EVENT, Recorder, Recording, Session, read_records
from needleplan.recording.export import FORMATS
from needleplan.simulation import Move, Simulation, simulated_station
from needleplan.stopping import Rest
from tests.cli.commands import needleplan
from tests.control.scenes import FAST, NOISY, WIDE, a_lab, coil_of, insertion_in, small_table, station_of


def recorded(folder: Path, seed: int, **effects: float) -> tuple[Path, InsertionReport]:
    lab = a_lab(replace(NOISY, **effects), seed)
    setup = RunSetup(FAST, WIDE, coil_of(lab))
    path = folder / "run.mcap"
    with RunRecorder(path, small_table(), setup, lab.clock) as recorder:
        report = insertion_in(lab, listeners=[recorder]).run()
    return path, report


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, InsertionReport]:
    return recorded(tmp_path_factory.mktemp("run"), 1, curvature_error=0.25)


@pytest.mark.slow
def test_curvature_sensors_and_images_guide_a_run_and_its_replay(tmp_path: Path) -> None:
    effects = replace(NOISY, fibre_noise_per_mm=2e-4, ultrasound_noise_mm=1.0, ultrasound_delay_s=0.1)
    setup = replace(a_lab(effects).plant.setup, fibre=FibreSensors((5.0, 20.0)), ultrasound=ImagePlane())
    table = small_table()
    station = simulated_station(Simulation(setup, (Move(dwell_s=1.0),)), table, table.best_entry(), 2)
    settings = TipSettings(image_latency_s=0.1)
    run = RunSetup(FAST, WIDE, station.registration, settings, "", station.fibre, station.plane)
    with RunRecorder(tmp_path / "run.mcap", table, run, station.clock) as recorder:
        Insertion(
            table, station, FAST, registration=run.registration, tip_settings=settings, limits=WIDE,
            accepted_limits="a fast lab", listeners=[recorder],
        ).run()  # fmt: skip
    recording = Recording.read(tmp_path / "run.mcap")
    assert recording.counts["/fibre"] > 4 * recording.counts["/image"] > 100
    assert replay(recording, table).differences == ()
    blind = RunSetup.from_texts({name: text for name, text in run.texts.items() if name[0] not in "fu"})
    assert RunSetup.from_texts(run.texts) == run != blind


@pytest.mark.slow
@pytest.mark.parametrize("source", [Source.FIBRE, Source.IMAGE])
def test_a_sensor_that_improves_the_tip_and_falls_silent_ends_the_run(source: Source) -> None:
    setup = replace(a_lab(NOISY).plant.setup, fibre=FibreSensors((5.0, 20.0)), ultrasound=ImagePlane())
    table = small_table()
    station = simulated_station(Simulation(setup, (Move(dwell_s=1.0),)), table, table.best_entry(), 2)
    device, read = station.more[source], station.more[source].read
    begun_ns = station.clock.now_ns()

    def silent(timeout_s: float) -> Sample | None:
        return None if station.clock.now_ns() - begun_ns > 2e9 else read(timeout_s)

    device.read = silent  # type: ignore[method-assign]
    report = Insertion(
        table, station, FAST, registration=station.registration, limits=WIDE, accepted_limits="a fast lab",
    ).run()  # fmt: skip
    assert report.outcome is InsertionOutcome.FAULT
    assert report.cause == f"{source}: no sample for 1 s"
    assert report.rest is Rest.RESTS


@pytest.mark.slow
def test_everything_is_in_it(run: tuple[Path, InsertionReport]) -> None:
    path, report = run
    recording = Recording.read(path)
    table = small_table()
    assert recording.session.digests["table"] == table.digest
    assert recording.session.digests["scenario"] == table.scenario.digest
    assert recording.session.texts["scenario.toml"] == table.scenario.to_toml()
    decisions = [each.values for each in recording.messages(["/decision"])]
    assert [each["value"] for each in decisions] == [step.value for step in report.steps]
    assert [tuple(each["state"]) for each in decisions] == [step.state for step in report.steps]
    events = [each.values for each in recording.messages(["/event"])]
    assert [each["name"] for each in events] == [str(event.name) for event in report.events]
    swapped = [each for each in events if each["name"] == "table_swapped"]
    assert len(swapped) == report.replans >= 1
    assert all(each["digest"].startswith("sha256:") for each in swapped)
    assert recording.counts["/tip"] == len(report.executed_mm)
    tips = [each.values for each in recording.messages(["/tip"])]
    assert np.array_equal(np.array([[each["x_mm"], each["y_mm"]] for each in tips]), report.executed_mm[:, :2])
    safety = [each.values for each in recording.messages(["/safety"])]
    assert any(each["name"] == "transition" and each["state"] == "ENABLED" for each in safety)
    commands = [each.values for each in recording.messages(["/command"])]
    goals = [each["goal"] for each in commands if each["kind"] == "insert"]
    assert len(set(goals)) == len(report.steps)  # after a pause the goal of the step is sent again
    assert commands[-1]["kind"] == "stop"


@pytest.mark.parametrize(("kind", "name"), [("hdf5", "run.h5"), ("csv", "run.csv")])
def test_it_exports(run: tuple[Path, InsertionReport], tmp_path: Path, kind: str, name: str) -> None:
    FORMATS[kind](Recording.read(run[0]), tmp_path / name)
    (trial,) = read_records(tmp_path / name)
    assert {"depth_mm", "force_n", "x_mm"} <= trial.columns.keys()
    assert trial.columns["depth_mm"][-1] == pytest.approx(run[1].inserted_mm, abs=0.1)


@pytest.mark.slow
def test_the_loop_on_the_recording_decides_as_it_did(run: tuple[Path, InsertionReport]) -> None:
    again = replay(Recording.read(run[0]), small_table())
    assert again.differences == ()
    assert again.same
    assert again.recorded == again.decisions == len(run[1].steps)
    assert again.report.steps == run[1].steps
    assert again.report.replans == run[1].replans >= 1


@pytest.mark.study
def test_a_changed_recording_is_told_apart(run: tuple[Path, InsertionReport], tmp_path: Path) -> None:
    """One decision of the recording is another one."""
    recording = Recording.read(run[0])
    changed = tmp_path / "changed.mcap"
    with Recorder(changed, recording.session) as recorder:
        channels = {topic: recorder.channel(topic, kind) for topic, kind in recording.kinds.items()
                    if topic not in ("/session", "/recorder")}  # fmt: skip
        for message in recording.messages(channels):
            values = message.values
            if message.topic == "/decision" and values["number"] == 2:
                values = values | {"action": "nothing"}
            if message.topic == "/command" and values["kind"] == "insert":
                values = values | {"goal": values["goal"] + 1e-3}
            channels[message.topic].put(message.time_ns, values)
    again = replay(Recording.read(changed), small_table())
    assert not again.same
    assert again.differences[0] == f"decision 2: action {run[1].steps[2].action.name.lower()}, in the recording nothing"
    sent = sum(each.values["kind"] == "insert" for each in recording.messages(["/command"]))
    assert sum("but insert to" in each for each in again.differences) == sent >= len(run[1].steps)


def test_another_table_is_refused(run: tuple[Path, InsertionReport]) -> None:
    scenario = small_table().scenario
    other = plan(replace(scenario, objective=replace(scenario.objective, rotation=5.0)))
    with pytest.raises(DataError, match=r"digest.table = .*must be equal to the digest of the table"):
        replay(Recording.read(run[0]), other)


def test_a_recording_of_something_else_is_refused(tmp_path: Path) -> None:
    with Recorder(tmp_path / "other.mcap", Session("other")) as recorder:
        recorder.channel("/event", EVENT).put(0, {"name": "x"})
    with pytest.raises(DataError, match="not the recording of an insertion"):
        replay(Recording.read(tmp_path / "other.mcap"), small_table())


def test_the_setup_comes_back_from_its_texts() -> None:
    push = TargetPush(NeedlePush(0.01, 0.6), 0.3)
    setup = RunSetup(replace(FAST, torsion=Torsion(1.5e4, 0.05), force_axis=(0.0, 0.0, -1.0), push=push), WIDE)
    assert RunSetup.from_texts(setup.texts) == setup
    options = json.loads(setup.texts["options.json"]) | {"velocity_mm_s": -1.0}
    with pytest.raises(DataError, match="velocity_mm_s"):
        RunSetup.from_texts(setup.texts | {"options.json": json.dumps(options)})


def test_a_refused_registration_moves_no_needle_and_replays_none(tmp_path: Path) -> None:
    reasons = ("residual: 40 mm",)
    refused = Registration(verdict=RegistrationVerdict(VerdictStatus.REFUSED, reasons=reasons))
    texts = RunSetup().texts | {"registration.toml": refused.to_toml()}
    with pytest.raises(DataError, match=r"verdict.status = .refused.*residual: 40 mm"):
        RunSetup.from_texts(texts)
    with pytest.raises(DataError, match="no needle may follow it: residual: 40 mm"):
        Insertion(small_table(), station_of(a_lab()), registration=refused)
    told = {}
    for name, registration in (("refused", refused), ("none", Registration())):
        file = tmp_path / f"{name}.mcap"
        with RunRecorder(file, small_table(), RunSetup(registration=registration), VirtualClock()):
            pass
        told[name] = json.loads(needleplan("recording", "info", file, "--json").stdout)["registration"]["status"]
        assert name in needleplan("recording", "info", file).stdout or name == "none"
    assert told == {"refused": "refused", "none": "none"}


@pytest.mark.slow
def test_an_end_by_a_fault_replays_to_where_it_was(tmp_path: Path) -> None:
    path, report = recorded(tmp_path, 2, tracker_dropout=0.02, tracker_dropout_s=8.0)
    assert report.outcome is InsertionOutcome.FAULT
    again = replay(Recording.read(path), small_table())
    assert again.differences == ()


def test_what_is_not_in_it_is_told(tmp_path: Path) -> None:
    with RunRecorder(tmp_path / "run.mcap", small_table(), RunSetup(), VirtualClock()) as recorder:
        recorder.event(RunEvent(0, RunEventName.BEGIN, "test", "", 0))
        recorder.tip(0, 0.0, None)  # type: ignore[arg-type]
    assert "1 messages were refused: /tip" in recorder.missing
    assert Recording.read(tmp_path / "run.mcap").counts["/event"] == 1
