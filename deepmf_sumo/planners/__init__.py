"""What drives the AV. One file a planner; `base.Planner` is the contract.

A planner gets a `View` each step and answers with a command: a speed, a pose, or a model of SUMO.
Planners in this process, in another program, behind HTTP and in a Gymnasium environment see the
same view, and are held to the same checks (`_checked`).

Why so: a team tests the planner that it has, in the language that it is written in. What is outside
the process may hang, crash or answer nonsense; `remote` ends it, and the run says what happened.
"""
