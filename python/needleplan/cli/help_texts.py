"""Groups of the commands in the help, and examples of every command."""

from __future__ import annotations

__all__ = ["COMMAND_GROUPS", "EXAMPLES"]

COMMAND_GROUPS: dict[str, tuple[str, ...]] = {
    "plan": ("plan", "path", "evaluate", "entry", "view", "info", "scenarios", "new", "case"),
    "many plans": ("sweep", "study"),
    "models from recordings": ("identify", "predict", "diagnose", "compare", "recording"),
    "tracked needle": ("calibrate", "register"),
    "insertion": ("simulate", "lab", "insert", "retract", "stop", "pause", "resume"),
    "other": ("reproduce", "doctor", "check-realtime", "check-robot", "completion"),
}
"""Names of the commands by title of their group, in the order of the help."""

EXAMPLES: dict[str, tuple[str, ...]] = {
    "": (
        "needleplan plan four_obstacles -o table.h5",
        "needleplan insert table.h5 -o run.mcap",
    ),
    "plan": (
        "needleplan plan four_obstacles -o table.h5",
        "needleplan plan brain --needle needle.toml -o table.h5 --figure table.png",
    ),
    "path": (
        "needleplan path table.h5 --figure path.png",
        "needleplan path table.h5 --start 0,40,10,1 --json",
    ),
    "evaluate": (
        "needleplan evaluate table.h5",
        "needleplan evaluate table.h5 --start 0,40,10 --runs 1e5 --seed 1",
    ),
    "entry": (
        "needleplan entry table.h5 --edge top",
        "needleplan entry anatomy.toml -o entries.csv --figure entries.png",
    ),
    "view": (
        "needleplan view four_obstacles",
        "needleplan view table.h5 --export plan.html",
    ),
    "info": (
        "needleplan info table.h5",
        'needleplan info published --needle-name "18 GA" --velocity 8',
    ),
    "predict": (
        "needleplan predict now.csv --earlier first.csv second.csv third.csv",
        "needleplan predict fourth.csv --earlier first.csv second.csv third.csv --until 50",
    ),
    "check-realtime": (
        "needleplan check-realtime",
        "needleplan check-realtime --seconds 10 --json",
    ),
    "check-robot": (
        "needleplan check-robot udp://192.168.1.10 --may-move 2",
        "needleplan check-robot udp://127.0.0.1:5105 --may-move -2 --only stop --json",
    ),
    "doctor": (
        "needleplan doctor",
        "needleplan doctor --json",
    ),
    "case": (
        "needleplan case masks --radius 80 --gauge 20 -o case.toml",
        "needleplan case masks --role lesion_2=target --entry-point 62,36,8 --radius 80 --margin 2 -o case.toml",
    ),
    "scenarios": (
        "needleplan scenarios",
        "needleplan scenarios --json",
    ),
    "new": (
        "needleplan new mine --from brain",
        "needleplan new phantom --anatomy liver --seed 3",
    ),
    "sweep": (
        "needleplan sweep curvature_and_noise -o store",
        "needleplan sweep sweep.toml -o /shared/store --scheduler tcp://10.0.0.5:8786",
    ),
    "study": (
        "needleplan study map store --figure map.png",
        "needleplan study mismatch store --planned curvature_radius_mm=50",
    ),
    "identify": (
        "needleplan identify force trials.csv -o model.toml --figure fit.png",
        "needleplan identify curvature trials.csv --scenario brain -o needle.toml",
    ),
    "diagnose": (
        "needleplan diagnose model.toml trials.csv -o found",
        "needleplan diagnose model.toml trials.csv --holdout later.csv -o found --force",
    ),
    "compare": (
        "needleplan compare found/model.toml later.csv",
        "needleplan compare found/model.toml later.csv --json",
    ),
    "recording": (
        "needleplan recording info run.mcap",
        "needleplan recording export run.mcap --to csv -o run.csv",
    ),
    "recording info": (
        "needleplan recording info run.mcap",
        "needleplan recording info run.mcap --events",
    ),
    "recording recover": (
        "needleplan recording recover run.mcap.partial -o run.mcap",
        "needleplan recording recover run.mcap.partial -o run.mcap --json",
    ),
    "recording export": (
        "needleplan recording export run.mcap --to csv -o run.csv",
        "needleplan recording export run.mcap --to parquet -o run",
    ),
    "recording replay": (
        "needleplan recording replay run.mcap --table table.h5",
        "needleplan recording replay run.mcap --table table.h5 --table-set store",
    ),
    "calibrate": (
        "needleplan calibrate poses.csv --rest rest.csv",
        "needleplan calibrate poses.csv --noise-mm 0.2 --json",
    ),
    "register": (
        "needleplan register --pivot poses.csv --points points.csv --rest rest.csv -o registration.toml",
        "needleplan register --pivot poses.csv --points points.csv --noise-mm 0.2 --target 100,50",
    ),
    "simulate": (
        "needleplan simulate insertion -o run.mcap",
        "needleplan simulate friction --runs 5 -o trials.csv",
    ),
    "lab": (
        "needleplan lab",
        "needleplan lab steering --table table.h5 -o registration.toml",
    ),
    "insert": (
        "needleplan insert table.h5 -o run.mcap --figure run.png",
        "needleplan insert table.h5 --robot udp://10.0.0.2 --force-sensor udp://10.0.0.3 "
        "--tracker tcp://10.0.0.4 --registration registration.toml",
    ),
    "retract": (
        "needleplan retract --robot udp://10.0.0.2",
        "needleplan retract --robot udp://10.0.0.2 --depth 20 --speed 2",
    ),
    "stop": (
        "needleplan stop --robot udp://10.0.0.2",
        "needleplan stop --robot udp://10.0.0.2 --within 10",
    ),
    "pause": (
        "needleplan pause --robot udp://10.0.0.2",
        "needleplan pause --robot udp://10.0.0.2 --by anna",
    ),
    "resume": (
        "needleplan resume --robot udp://10.0.0.2",
        "needleplan resume --robot udp://10.0.0.2 --by anna",
    ),
    "reproduce": (
        "needleplan reproduce ch5",
        "needleplan reproduce diagnosis --quick -o results",
    ),
    "completion": (
        "needleplan completion bash",
        "needleplan completion fish > ~/.config/fish/completions/needleplan.fish",
    ),
}
"""Two command lines for each command; the empty name is the program."""
