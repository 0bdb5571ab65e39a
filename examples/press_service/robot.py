"""A robot that takes parts out of the press, and a planner that calls the press."""

from __future__ import annotations

import os
import sys
import threading

from shm_msgs.press_msgs.srv import (
    Run_Request,
    RunClient,
    Unload_Request,
    Unload_Response,
    UnloadServer,
)

from shmgen.runtime import CallFailed, CallTimeout

parts: list[int] = []
is_over = threading.Event()


def robot(service: str) -> None:
    """Serve the robot's service until the planner has finished."""
    with UnloadServer(service) as server:
        while not is_over.is_set():
            server.serve(unload, timeout=0.1)


def unload(request: Unload_Request) -> Unload_Response:
    parts.append(request.part)
    return Unload_Response(placed=True)


def main(run: str, unloading: str) -> int:
    """Run the planner. Return 0 if the press pressed the requested parts and each failed call was reported."""
    print(f"   robot and planner are process {os.getpid()}")
    thread = threading.Thread(target=robot, args=(unloading,))
    thread.start()
    with RunClient(run) as client:
        response = client.call(Run_Request(parts=3, force=25.0), timeout=10)
        duration = f"{response.seconds:.2f} s"
        print(f"   3 parts with 25 kN: {response.pressed_parts} pressed in {duration}, the robot took {parts}")
        try:
            client.call(Run_Request(parts=1, force=60.0), timeout=10)
        except CallFailed as error:
            print(f"   1 part with 60 kN: {error}")
        try:
            client.call(Run_Request(parts=5, force=25.0), timeout=0.03)
        except CallTimeout as error:
            print(f"   5 parts within 0.03 s: {error}")
        later_response = client.call(Run_Request(parts=2, force=25.0), timeout=10)
        count = later_response.pressed_parts
        print(f"   2 parts: {count} pressed; this response is not the late result of the previous call")
    is_over.set()
    thread.join()
    expected = [1, 2, 3, 1, 2, 3, 4, 5, 1, 2]
    return 0 if response.pressed_parts == 3 and count == 2 and parts == expected else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
