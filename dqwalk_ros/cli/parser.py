"""The grammar of the command line, and the help that teaches it."""

from __future__ import annotations

import argparse
from typing import Any

__all__ = ["build"]

_TOP = """\
examples:
  dqwalk simulate --cycles 1 --out walk     walk in this process: bag, figures and report in walk/
  dqwalk walk --cycles 1 --out walk         the same through ROS 2, four nodes as processes of their own
  dqwalk reach                              walk where the hand wants to go (whole body)
  dqwalk report walk/bag                    judge and draw any recorded walk
  dqwalk view walk/bag                      look at it in the browser: play, pause, scrub
  dqwalk robustness, dqwalk pushes          what the walk that stands survives in physics
  dqwalk study studies/step_length.yaml     walk many times over with parameters varied
  dqwalk config                             every parameter with its unit, range and meaning

exit code: 0 all went well; 1 the walk failed or broke a promise; 2 arguments or configuration of no use
"""

_SIMULATE = """\
writes to the folder of --out:
  bag/                 the walk as a rosbag2 (MCAP): ros2 bag, Foxglove, PlotJuggler, `dqwalk report`
  report.json          every phase, distance, margin and violation
  figure7 8 9, top_view

Ctrl-C stops the walk and keeps what was walked.

examples:
  dqwalk simulate                                          the paper's walk, one cycle
  dqwalk simulate --cycles 3 --first right --out walk
  dqwalk simulate --set gait.step_length=0.03 --set dsp.flat_feet=false
  dqwalk simulate --config my_robot.yaml --format png,pdf
  dqwalk simulate --view                                   look at it while it is computed
  dqwalk simulate --config poppy --plant physics           the walk that stands, in MuJoCo (dqwalk_ros[sim])
  dqwalk simulate --config poppy --plant physics --cmd-vel 0.015,0,0,20 --cmd-vel=-0.01,0,0,20    on, and back
"""

_REACH = """\
A robot of HRP-2's size reaches for a target with its right hand and walks there by itself; its steps are nobody's
plan. Test 1 moves the target in mid-swing, Test 2 also pushes the torso, 15 N s twice. Needs pinocchio: pip install pin

writes to the folder of --out:
  bag/, or bag_1/ and bag_2/   the walks as rosbag2 (MCAP), as the nodes' recorder makes them: `dqwalk report`
  figure2 3 4 5                solving time, the walk from above, reactions to target and pushes
  pushes                       --pushes: the hardest push that is survived, all around
  report.json                  every figure of the tables

--all makes 14 walks (a minute or two of two processors) and prints what is asked of the controller beside what was got:
exactness of equations and answers, Tests 1 and 2, walking in place, harder pushes, less friction, no balance, times.
Exit code 1 where a demand is not met; an aim may be missed.

times are CPU time of this process; OPENBLAS_NUM_THREADS=1 keeps it from using threads that do not help here.

examples:
  dqwalk reach                                             both tests of the paper
  dqwalk reach --all                                       everything it must show, asked and got
  dqwalk reach --pushes --plant both                       how hard it may be hit, in MuJoCo and on rigid ground
  dqwalk reach --test 1 --target 0.8,-0.3,0.9              a target of your own
  dqwalk reach --test 1 --push 2.5,0,20,0                  hit it harder: 20 N s to the left at 2.5 s
  dqwalk reach --test 1 --set whole_body.capturability=false --duration 3     it falls
  dqwalk report reach/bag_1 --html                         look at the walk: replay in 3D, figures, table
"""

_ROBUSTNESS = """\
Walks every combination of friction, mass, servo stiffness, backlash, output rate and latency (432 of them, about
six seconds of one core each) and prints the fraction that stood and why the others did not. Needs dqwalk_ros[sim].

writes to the folder of --out:
  cells.jsonl             a line per finished cell; a run that was stopped or killed goes on from here
  robustness.csv, .txt    all cells in order, and the table that is printed
  robustness.png          the matrix: what stood, and after how many steps the rest fell

examples:
  dqwalk robustness --jobs 4 --set qp.solver=daqp          daqp gives the same answers in less time
  dqwalk robustness --sample 40
  dqwalk robustness --axis servo.stiffness=60 --axis servo.latency=0,0.06 --steps 4
"""

_PUSHES = """\
Pushes the pelvis of a walking robot in physics, in eight directions, standing on both feet and in the middle of a
step on either foot, harder and harder until it falls, and prints the largest impulse survived. Needs dqwalk_ros[sim].

writes to the folder of --out:
  pushes.csv, .txt, .png

examples:
  dqwalk pushes --jobs 4 --set qp.solver=daqp
  dqwalk pushes --moment standing --directions 16 --set standing.balance=1.0
"""

_FOOTSTEPS = """\
A footprint that is asked for is moved to the nearest one that can be reached with both soles flat and the centre of
mass over either of them. This prints what comes of steps ahead, aside and round.

examples:
  dqwalk footsteps
  dqwalk footsteps --config my_biped.yaml --support right
"""

_REPORT = """\
The bag may be MCAP or SQLite, split or compressed, recorded by `dqwalk` or by `ros2 bag record`, or cut off by
a crash: then the report says what is missing. All distances are computed anew from joint_states and the phases.

examples:
  dqwalk report walk/bag
  dqwalk report walk/bag --out paper --format pdf
  dqwalk report walk/bag --html                            report.html: opens offline, with a replay in 3D
  dqwalk report walk/bag --compare slower/bag              the two side by side
  dqwalk report walk/bag --json | jq .walk.margin
  dqwalk report rosbag2_2025_01_31/ --namespace poppy_1
"""

_WALK = """\
Starts controller, plant, phase_monitor and recorder in lockstep (each state waits for its command, so the
walk is exact and as fast as the machine), records a bag, and reports on it.

examples:
  dqwalk walk --out walk
  dqwalk walk --cycles 2 --set ssp.com_radius=0.045
  dqwalk walk --realtime                                   at 1/dt by the clock instead
  dqwalk walk --config poppy --plant physics --set gait.steps=20        20 steps in MuJoCo
  dqwalk walk --config poppy --plant physics --cmd-vel 0.015,0,0.03,30  steered by the node pilot on cmd_vel
"""

_VIEW = """\
Serves a page on 127.0.0.1 until Ctrl-C: the robot, its soles and support polygon, the planes and cylinders of the
current phase, the centre of mass and its way, and every margin over time, the tightest one marked. The bag may be
any that `dqwalk report` reads. On another machine, forward the port: ssh -L 8080:127.0.0.1:8080 HOST.

examples:
  dqwalk view walk/bag                                     a recorded walk
  dqwalk view walk/bag --open                              and open the browser
  dqwalk simulate --view                                   a walk while it is computed
  dqwalk_viewer                                            a walk on ROS 2, live (or: ros2 run dqwalk_ros viewer)
"""

_MOVIE = """\
Draws the robot as its URDF shows it, by MuJoCo, without a display: set MUJOCO_GL=egl (or osmesa) where there is
none. A bag of a walk in physics has the true pose of the pelvis, otherwise it is that of the odometry.
Needs dqwalk_ros[sim].

examples:
  MUJOCO_GL=egl dqwalk movie walk/bag --out walk.gif --speed 4
  MUJOCO_GL=egl dqwalk movie walk/bag --out strip.png --strip 9 --between 0,7.5
"""

_STUDY = """\
a study is a file such as
  config: paper                     # a name or a path, as of --config
  set: {gait.cycles: 1}             # the same in every walk
  sample: grid                      # or latin_hypercube, sobol, with `count: 64` and `seed: 0`
  vary:
    gait.step_length: {from: 0.02, to: 0.12, steps: 6}
    dsp.flat_feet: [true, false]    # a list of values
    start.l_knee_y: [0.0, 0.2]      # first angle of a joint [rad]
    mass.pelvis: [1.0, 1.5]         # factor on the mass of the body that carries a link
    disturbance.velocity: [0.0, 0.01]   # standard deviation, every joint, every tick [rad/s]

writes to the folder of --out:
  walks.jsonl      a line per finished walk; a study that was stopped or killed goes on from here
  walks.parquet    all walks in order: parameters, finished, end, duration, error, margins (pandas.read_parquet)
  study.png        which walks finished, and their margins

needs: pip install 'dqwalk_ros[study]'

examples:
  dqwalk study studies/step_length.yaml --jobs 2
  dqwalk study mine.yaml --dry-run
  dqwalk study mine.yaml --scheduler tcp://127.0.0.1:8786
"""

_CONFIG = """\
Without CONFIG: the list of all parameters. With CONFIG: check it and print it in full, as a ROS parameter file.

examples:
  dqwalk config                                            every parameter
  dqwalk config --section ssp                              those of one section
  dqwalk config paper > mine.yaml                          begin a configuration of your own
  dqwalk config mine.yaml --check                          is it usable?
  dqwalk config paper --set gait.step_length=0.04
"""


def build() -> argparse.ArgumentParser:
    """Return the parser of ``dqwalk``."""
    top = argparse.ArgumentParser(
        prog="dqwalk",
        description="Biped walking control with quadratic programming and vector-field inequalities.",
        epilog=_TOP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)

    simulate = _command(commands, "simulate", "walk in this process, without ROS", _SIMULATE)
    _add_walk(simulate)
    _add_output(simulate, "walk")
    simulate.add_argument("--view", action="store_true", help="show the walk in the browser, live, then as a replay")
    simulate.add_argument("--port", type=int, help="port of the page; 0: any [8080, or the next free one]")
    _add_course(simulate)
    simulate.add_argument(
        "--plant", choices=("kinematic", "physics"), default="kinematic", help="joints that obey, or MuJoCo [kinematic]"
    )

    robust = _command(commands, "robustness", "walk in physics on robots and floors that differ", _ROBUSTNESS)
    robust.add_argument("--config", metavar="CONFIG", default="poppy", help="name or path of a configuration [poppy]")
    robust.add_argument("--steps", metavar="N", type=int, default=10, help="steps of each walk [10]")
    robust.add_argument("--axis", metavar="KEY=A,B", action="append", default=[], help="vary this parameter so instead")
    robust.add_argument("--sample", metavar="N", type=int, default=0, help="walk N combinations, drawn at random [all]")
    robust.add_argument("--seed", type=int, default=0, help="of the draw [0]")
    robust.add_argument("--jobs", metavar="N", type=int, default=2, help="processes at a time [2]")
    robust.add_argument("--out", metavar="DIR", default="robustness", help="where the results go [robustness]")
    robust.add_argument("--force", action="store_true", help="replace an earlier matrix that is there")
    robust.add_argument("--quiet", action="store_true", help="no progress")
    _add_set(robust)

    feet = _command(commands, "footsteps", "which steps the legs of a robot reach", _FOOTSTEPS)
    feet.add_argument("--config", metavar="CONFIG", default="poppy", help="name or path of a configuration [poppy]")
    feet.add_argument("--support", choices=("left", "right"), default="left", help="foot that stands [left]")
    _add_set(feet)

    push = _command(commands, "pushes", "find the largest push the robot survives", _PUSHES)
    push.add_argument("--config", metavar="CONFIG", default="poppy", help="name or path of a configuration [poppy]")
    push.add_argument("--moment", choices=("all", "standing", "left", "right"), default="all", help="when [all]")
    push.add_argument("--directions", metavar="N", type=int, default=8, help="evenly spread [8]")
    push.add_argument("--duration", metavar="S", type=float, default=0.1, help="of each push [0.1]")
    push.add_argument("--tolerance", metavar="NS", type=float, default=0.02, help="of each impulse [0.02]")
    push.add_argument("--jobs", metavar="N", type=int, default=2, help="processes at a time [2]")
    push.add_argument("--out", metavar="DIR", default="pushes", help="where the results go [pushes]")
    push.add_argument("--quiet", action="store_true", help="no progress")
    _add_set(push)

    walk = _command(commands, "walk", "walk through ROS 2: four nodes, lockstep", _WALK)
    _add_walk(walk)
    _add_output(walk, "walk")
    _add_course(walk)
    walk.add_argument(
        "--plant",
        choices=("integrator", "physics", "poppy"),
        default="integrator",
        help="joints that obey, MuJoCo, or the real robot (by the clock) [integrator]",
    )
    walk.add_argument("--realtime", action="store_true", help="run by the clock, at 1/dt, instead of in lockstep")

    reach = _command(commands, "reach", "reach for a target with the whole body, and get pushed", _REACH)
    reach.add_argument("--config", metavar="CONFIG", default="whole_body", help="name or path [whole_body]")
    reach.add_argument("--test", choices=("1", "2", "both"), default="both", help="of the paper [both]")
    reach.add_argument("--all", action="store_true", help="everything the controller must show, asked and got")
    reach.add_argument("--pushes", action="store_true", help="the hardest push survived, in eight directions")
    reach.add_argument("--when", metavar="S", type=float, default=2.5, help="--pushes: when the robot is hit [2.5]")
    reach.add_argument("--exact", metavar="R", type=float, default=1.0, help="--pushes: to so many N s [1]")
    reach.add_argument("--jobs", metavar="N", type=int, default=2, help="--all, --pushes: processes at a time [2]")
    reach.add_argument(
        "--plant", choices=("rigid", "physics", "both"), default="rigid", help="physics: MuJoCo, by torques [rigid]"
    )
    reach.add_argument("--paper-times", action="store_true", help="the target jumps at 4 and 8 s, not as in the thesis")
    reach.add_argument("--target", metavar="X,Y,Z", help="one target for the hand instead of the test's [m]")
    reach.add_argument("--push", metavar="T,X,Y,Z", action="append", default=[], help="another push [s, N s]")
    reach.add_argument("--duration", metavar="S", type=float, help="instead of the test's 14 s")
    _add_set(reach)
    _add_output(reach, "reach")

    report = _command(commands, "report", "judge and draw a recorded walk", _REPORT)
    report.add_argument("bag", metavar="BAG", help="folder of a rosbag2, or one .mcap or .db3 file")
    report.add_argument("--namespace", metavar="NAME", help="of the robot, where the bag holds several")
    report.add_argument("--html", action="store_true", help="also one offline page: replay, figures, tables")
    report.add_argument("--compare", metavar="BAG", help="another walk, side by side on that page")
    report.add_argument("--csv", action="store_true", help="also every series as series.csv, a line per state")
    report.add_argument("--json", action="store_true", help="print the report as JSON instead of tables")
    _add_output(report, None)

    view = _command(commands, "view", "look at a recorded walk in the browser", _VIEW)
    view.add_argument("bag", metavar="BAG", help="folder of a rosbag2, or one .mcap or .db3 file")
    view.add_argument("--namespace", metavar="NAME", help="of the robot, where the bag holds several")
    view.add_argument("--port", type=int, help="port of the page; 0: any [8080, or the next free one]")
    view.add_argument("--open", action="store_true", help="open the page in the browser of this machine")
    view.add_argument("--play", action="store_true", help="begin to play at once")

    movie = _command(commands, "movie", "draw a recorded walk as a movie or a strip of pictures", _MOVIE)
    movie.add_argument("bag", metavar="BAG", help="folder of a rosbag2, or one .mcap or .db3 file")
    movie.add_argument("--namespace", metavar="NAME", help="of the robot, where the bag holds several")
    movie.add_argument("--out", metavar="FILE", default="walk.gif", help=".gif, .webp, or .png for a strip [walk.gif]")
    movie.add_argument("--speed", type=float, default=2.0, help="so many times as fast as it was walked [2]")
    movie.add_argument("--rate", type=float, default=12.5, help="pictures per second [12.5]")
    movie.add_argument("--strip", metavar="N", type=int, default=8, help="pictures of a strip [8]")
    movie.add_argument("--between", metavar="A,B", help="first and last time of a strip [s] [the whole walk]")
    movie.add_argument("--quiet", action="store_true", help="no progress")

    study = _command(commands, "study", "walk many times over with parameters varied", _STUDY)
    study.add_argument("study", metavar="STUDY.yaml", help="what is varied, as below")
    study.add_argument("--out", metavar="DIR", help="where the results go [STUDY_study]")
    study.add_argument("--jobs", metavar="N", type=int, default=1, help="processes on this machine [1]")
    study.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask scheduler to walk on instead")
    study.add_argument("--dry-run", action="store_true", help="check the study and say how many walks it has")
    study.add_argument("--format", metavar="LIST", type=_formats, default=("png",), help="figure: png, pdf, svg [png]")
    study.add_argument("--quiet", action="store_true", help="no progress, no summary")

    config = _command(commands, "config", "list, check or print parameters", _CONFIG)
    config.add_argument(
        "config", metavar="CONFIG", nargs="?", help="name of one of ours (paper) or path of a YAML file"
    )
    config.add_argument("--section", metavar="NAME", help="list one section only")
    config.add_argument("--check", action="store_true", help="print nothing, only say whether it can be used")
    _add_set(config)

    _command(commands, "version", "versions of this package and of what it stands on", "")
    return top


def _command(commands: Any, name: str, summary: str, epilog: str) -> argparse.ArgumentParser:
    made: argparse.ArgumentParser = commands.add_parser(
        name,
        help=summary,
        description=summary[0].upper() + summary[1:] + ".",
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    return made


def _add_walk(command: argparse.ArgumentParser) -> None:
    command.add_argument("--config", metavar="CONFIG", default="paper", help="name or path of a configuration [paper]")
    command.add_argument("--cycles", metavar="N", type=int, help="walking cycles of four phases (gait.cycles)")
    command.add_argument("--first", choices=("left", "right"), help="foot that carries first (gait.first_support)")
    _add_set(command)


def _add_course(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--cmd-vel",
        metavar="X,Y,TURN,S",
        action="append",
        default=[],
        help="steer a standing walk: forward, left [m/s], turn [rad/s], for so long [s]; then the next, or stop",
    )


def _add_set(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="change one parameter; may be given several times; `dqwalk config` lists them",
    )


def _add_output(command: argparse.ArgumentParser, default: str | None) -> None:
    shown = default or "BAG_report"
    command.add_argument("--out", metavar="DIR", default=default, help=f"where the results go [{shown}]")
    if default:
        command.add_argument("--force", action="store_true", help="replace an earlier walk that is there")
    command.add_argument(
        "--format", metavar="LIST", type=_formats, default=("png",), help="figures: png, pdf, svg [png]"
    )
    command.add_argument("--no-figures", action="store_true", help="draw nothing")
    command.add_argument("--quiet", action="store_true", help="no progress, no tables")


def _formats(text: str) -> tuple[str, ...]:
    kinds = tuple(kind.strip().lower() for kind in text.split(",") if kind.strip())
    wrong = [kind for kind in kinds if kind not in ("png", "pdf", "svg")]
    if wrong or not kinds:
        raise argparse.ArgumentTypeError(f"png, pdf or svg, separated by commas, not '{text}'")
    return kinds
