"""A planner program that drives two steps and then misbehaves: ``hostile_planner.py HOW``."""

import json
import os
import sys
import time


def misbehave(how: str, step: int) -> str:
    good = {"type": "command", "step": step, "kind": "speed", "speed_mps": 5.0}
    match how:
        case "raise":
            raise ZeroDivisionError("a bug of the program")
        case "hang":
            time.sleep(600)
        case "nan":
            good["speed_mps"] = float("nan")
        case "wrong_length":
            return "[5.0, 0.0, 0.0]"
        case "fast":
            good["speed_mps"] = 1e9
        case "exit":
            sys.exit(3)
        case "gigabyte":
            while True:
                sys.stdout.write("x" * 1_000_000)
        case "gigabyte_of_lines":
            while True:
                sys.stdout.write("hello\n" * 100_000)
        case "gigabyte_of_complaints":
            for _ in range(1000):
                sys.stderr.write("x" * 1_000_000)
        case "fork":
            for _ in range(3):
                if os.fork() == 0:
                    os.setsid()
                    if os.fork():
                        os._exit(0)
                    time.sleep(600)  # in a session of its own, without a parent
                    os._exit(0)
            sys.exit(0)
        case "close_stdin":
            os.close(0)
            time.sleep(600)
        case "close_stdout":
            os.close(1)
            time.sleep(600)
        case "not_json":
            return "planning..."
        case "huge_line":
            good["leader_id"] = "x" * 1_000_000
        case "wrong_types":
            good["speed_mps"] = "fast"
        case "unknown_key":
            good["sped_mps"] = 3.0
        case "other_step":
            good["step"] = step - 1
        case "other_kind":
            good["kind"] = "fly"
        case "teleport":
            good = good | {"kind": "pose", "x_m": 0.0, "y_m": 5e3, "heading_rad": 0.0}
        case "deep":
            return "[" * 50_000
        case "kill_parent":
            os.kill(os.getppid(), 9)
            time.sleep(600)
    return json.dumps(good)


def main() -> None:
    how, steps = sys.argv[1], 0
    for line in sys.stdin:
        asked = json.loads(line)
        if asked["type"] == "reset":
            protocol = 2 if how == "other_protocol" else 1
            answer = json.dumps({"type": "ready", "protocol": protocol})
        else:
            steps += 1
            step = asked["step"]
            good = {"type": "command", "step": step, "kind": "speed", "speed_mps": 5.0}
            answer = misbehave(how, step) if steps == 3 else json.dumps(good)
        sys.stdout.write(answer + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
