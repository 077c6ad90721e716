// A run's packed replay -> the poses of all agents at any time.

/** The agents with a pose at each kept step, the plans with their paths, the road's shapes. */
function sceneOf(details, road) {
  const replay = details.replay;
  const turn = (2 * Math.PI) / replay.turn;
  const agents = replay.agents.map((agent) => ({
    ...agent,
    parts: agent.parts.map(([first, x, y, heading]) => ({
      first,
      x: restored(x, agent.unit),
      y: restored(y, agent.unit),
      heading: restored(heading, turn),
    })),
    speed: agent.speed ? { first: agent.speed[0], values: restored(agent.speed[1], 0.01) } : null,
  }));
  return {
    ...replay,
    agents,
    turns: details.turns,
    onset: details.onset ?? null,
    sees: details.sees,
    av: agents.find((agent) => agent.role === "av"),
    opponent: agents.find((agent) => agent.role === "opponent"),
    supporters: agents.filter((agent) => agent.role === "supporter"),
    main: ["av", "opponent", "attacker"].flatMap((role) =>
      agents.filter((agent) => agent.role === role),
    ),
    plans: details.reasons.map(planOf),
    lights: details.lights ?? [],
    shapes: road ? shapesOf(road, replay.origin) : [],
    timeline: timelineOf(replay.timeline),
  };
}

function planOf(plan) {
  return {
    ...plan,
    path: pathOf(plan.path),
    candidates: (plan.candidates ?? []).map((candidate) => ({
      ...candidate,
      path: pathOf(candidate.path),
      reactions: candidate.reactions.map((reaction) => ({
        ...reaction,
        path: pathOf(reaction.path),
      })),
    })),
  };
}

function pathOf([x, y]) {
  const across = restored(x, 0.1),
    up = restored(y, 0.1);
  return across.map((value, place) => [value, up[place]]);
}

function shapesOf(road, origin) {
  const dx = road.origin[0] - origin[0],
    dy = road.origin[1] - origin[1];
  return road.shapes.map(([kind, width, x, y]) => {
    const up = summed(y, road.unit);
    const points = summed(x, road.unit).map((value, place) => [value + dx, up[place] + dy]);
    return { kind, width: width * road.unit, points };
  });
}

function timelineOf(timeline) {
  if (typeof timeline === "string") return timeline;
  return { step: restored(timeline.step, 1), gap: restored(timeline.gap, 0.01), ttc: timeline.ttc };
}

/** What a light shows at a step: stop, caution, go or off; null before anything is known. */
function lightAt(changes, step) {
  let shown = null;
  for (const [first, state] of changes) if (first <= step + 1e-6) shown = state;
  return shown;
}

/** Pose {x, y, heading} of an agent at a step with fractions; null where it is not there. */
function poseAt(agent, step) {
  for (const part of agent.parts) {
    const place = (step - part.first) / agent.every,
      last = part.x.length - 1;
    if (place < 0 || place > last) continue;
    const low = Math.floor(place),
      high = Math.min(low + 1, last),
      share = place - low;
    const between = (values) => values[low] + share * (values[high] - values[low]);
    return { x: between(part.x), y: between(part.y), heading: between(part.heading) };
  }
  return null;
}

/** Whether the AV cannot see an agent at a step. */
function isUnseen(agent, step) {
  const at = Math.floor(step + 1e-6);
  return (agent.unseen ?? []).some(([first, last]) => first <= at && at <= last);
}

/** Road users that are there at a step, and hidden from the AV. */
function unseenAt(scene, step) {
  return scene.agents.filter((agent) => isUnseen(agent, step) && poseAt(agent, step));
}

/** Speed in m/s at a step, null where the agent is not there. */
function speedAt(agent, step) {
  const place = Math.round(step) - (agent?.speed?.first ?? 0);
  return agent?.speed?.values[place] ?? null;
}

/** The driver of the AV or the opponent at a step. */
function driverAt(agent, step) {
  let name = "";
  for (const [first, driver] of agent.drivers) if (first <= Math.round(step)) name = driver;
  return name;
}

/** The plan that drives at a step: the last one that has begun. */
function planAt(scene, step, agent) {
  const made = scene.plans.filter(
    (plan) => plan.step <= Math.floor(step) + 1 && plan.agent === (agent ?? plan.agent),
  );
  const last = made.at(-1);
  const main = made.findLast((plan) => plan.agent === scene.opponent?.id);
  return (main?.step === last?.step ? main : last) ?? null;
}

/** Gap and time to collision at a step. */
function conflictAt(scene, step) {
  if (typeof scene.timeline === "string") return null;
  const place = scene.timeline.step.indexOf(Math.round(step));
  return place < 0 ? null : { gap: scene.timeline.gap[place], ttc: scene.timeline.ttc[place] };
}
