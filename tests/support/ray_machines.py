"""A Ray cluster on this machine: a head without processors, and two machines with one each.

A program of its own, because Ray leaves processes and warnings behind. It answers each line of its
input, ``lose`` or ``complete``, with one of its own, and ends the cluster with its input.
"""

import os
import socket
import sys

os.environ["RAY_USAGE_STATS_ENABLED"] = "0"

from ray.cluster_utils import Cluster

MACHINES = 2


def main():
    port = free_port()
    head = {"num_cpus": 0, "ray_client_server_port": port, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args={**head, **ports()})
    machines = []
    complete(cluster, machines)
    print("up", port, flush=True)
    for line in sys.stdin:
        if line.strip() == "lose":  # as if its plug had been pulled
            cluster.remove_node(machines.pop(), allow_graceful=False)
        else:
            complete(cluster, machines)
        print("done", flush=True)
    cluster.shutdown()


def complete(cluster, machines):
    while len(machines) < MACHINES:
        machines.append(cluster.add_node(num_cpus=1, **ports()))


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def ports():
    """Of Ray's agents; without them it takes a moment longer to start."""
    names = (
        "metrics_agent_port", "metrics_export_port", "dashboard_agent_listen_port",
        "runtime_env_agent_port",
    )  # fmt: skip
    return {name: free_port() for name in names}


if __name__ == "__main__":
    main()
