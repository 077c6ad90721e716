"""The networks of the method, for inference: a view goes in, forecasts come out.

Three are the paper's; `people` has the one for pedestrians and cyclists.

The forward pass is four files: `encode` (what is read of a view, on the road of `lanes`),
`condition` (the given vehicle, and a driver who follows it), `densetnt` with the goals of `anchors`
(the network), `decode` (from goals to trajectories); `predict` puts them in order. `opponent`
scores the vehicles around the AV.

Why arrays, and not objects: a network reads columns, and trained weights fix their order. So each
array has a class that names its columns, once, and nothing else knows a column by its number.

Why two runtimes: torch trains and computes; ONNX Runtime computes where torch is too large. Both
end in numpy (`decode.GoalSet`): the choice of modes does not depend on the runtime. `encode`,
`lanes`, `opponent`, `decode` and `predict` therefore do without torch.
"""
