"""DeepMF: what an attack considers, how it chooses, and how it is driven.

At each replanning cycle the method takes the candidate trajectory of the opponent for which P(OV) x
sum over k of P(AV_k | OV) x collision is largest (rule ``expected``; by default a spec has
``likeliest``, the likeliest candidate of nearly the largest collision mass). Each factor is a part:
`networks` predict (inference only), `candidates` are what the opponent might do and which pairs
collide, `constraints` say which of these are allowed, `scoring` chooses, `tracking` drives.

Why it is as it is:

- A plan is made from one `situation.Situation`: view, opponent, sizes, limits, the unattacked AV,
  the last plan. Constraints are masks over candidates or pairs, so that any number of them combine;
  ``DeepMF._plan`` reads from top to bottom.
- Predictors keep nothing: ``predict(view, agent)`` returns a prediction that is passed on and
  queried (`networks.predict`). A policy can be copied, resumed and run beside others.
- A goal of DenseTNT is a (lane-graph path, speed profile) pair: it carries its timing, so that
  completion is a small residual along the path. With ``head: dense`` it is a place of a grid along
  the path (`networks.anchors`), with the timing of a constant acceleration: both end in one
  ``GoalSet``. Dense networks choose their paths themselves, so the marginal network is no prior for
  the conditional one.
- In preset ``light`` the opponent's future enters VGG16 after its third block, so that one encoding
  of the scene serves all candidates. Preset ``vector`` has no image and is the default of the
  trajectory networks; each network has its own sizes, on its card.
- Six of a path's speed profiles are hard braking, not fitted on data: recordings hold too little of
  it, and without them the conditional network cannot predict an AV that another vehicle comes close
  to.
- The conditional network is told whether a person or a planner drives its vehicle, and for how long
  the planner has: one set of weights serves recorded AVs and SUMO's. It is also told where the
  Intelligent Driver Model would be on each path behind the given vehicle.
- Several members of the marginal network are a mixture; the default is one.
"""
