// A moment of a run on a canvas.

/** Colours of the current theme. */
function palette() {
  const style = getComputedStyle(document.documentElement);
  return (name) => style.getPropertyValue(`--${name}`).trim();
}

/** Colours of the scores from 0 to 1, mixed in between. */
const scoreStops = [];
/** Name, kind of shapes, whether they are filled, width of edges, words: from the lowest. */
const mapLayers = [];

function scoreColour(score) {
  const place = Math.min(Math.max(score, 0), 1) * (scoreStops.length - 1),
    low = Math.min(Math.floor(place), scoreStops.length - 2);
  const mix = scoreStops[low].map((value, part) =>
    Math.round(value + (place - low) * (scoreStops[low + 1][part] - value)),
  );
  return `rgb(${mix.join(",")})`;
}

/** Bounds of what AV and opponent drive, with a margin. */
function drivenBounds(scene) {
  const places = [];
  for (const agent of scene.main) {
    for (const part of agent.parts) {
      part.x.forEach((x, place) => {
        if (part.first + place >= scene.now) places.push([x, part.y[place]]);
      });
    }
  }
  return widened(boundsOf(places) ?? [0, 0, 0, 0], 15);
}

/** Draw the scene at a step (with fractions). `shown` says which layers; `candidate` whose reactions. */
function drawMoment(canvas, scene, camera, step, shown, candidate) {
  const context = canvas.getContext("2d"),
    colour = palette();
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth,
    height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  const { x, y, scale } = camera;
  context.setTransform(
    ratio * scale,
    0,
    0,
    -ratio * scale,
    ratio * (width / 2 - scale * x),
    ratio * (height / 2 + scale * y),
  );
  const brush = { context, colour, metre: 1 / scale };
  if (shown.map) drawRoad(brush, scene.shapes);
  if (shown.lights) drawLights(brush, scene.lights, step);
  const attackers = attackersAt(scene, step);
  const plan = planAt(scene, step);
  for (const other of attackers) {
    const its = planAt(scene, step, other.id);
    if (its && its !== plan) drawPath(brush, its);
  }
  for (const one of scene.supporters) {
    const its = planAt(scene, step, one.id);
    if (its) drawPath(brush, its, "supporter");
  }
  if (plan) drawPlan(brush, plan, shown, candidate);
  if (shown.driven) scene.main.forEach((agent) => drawDriven(brush, scene, agent, step));
  const scores = shown.scores && plan?.scores ? plan.scores : {};
  for (const agent of scene.agents) {
    const hollow = shown.unseen && isUnseen(agent, step);
    drawAgent(brush, agent, roleAt(scene, attackers, agent), step, scores, hollow);
  }
  for (const contact of scene.contacts)
    if (step >= contact.step - 1e-6) drawContact(brush, contact);
  drawScale(context, ratio, height, scale, colour);
}

function roleAt(scene, attackers, agent) {
  if (agent === scene.av) return "av";
  if (attackers.includes(agent)) return "opponent";
  return agent.role === "supporter" ? "supporter" : "other";
}

function trace(context, points) {
  context.beginPath();
  points.forEach(([x, y], place) => (place ? context.lineTo(x, y) : context.moveTo(x, y)));
}

function drawRoad({ context, colour, metre }, shapes) {
  context.setLineDash([]);
  context.lineJoin = "round";
  context.lineCap = "butt";
  for (const [name, of, filled, width] of mapLayers) {
    for (const shape of shapes) {
      if (shape.kind !== of) continue;
      trace(context, shape.points);
      if (filled && shape.width) {
        context.strokeStyle = colour(`map-${name}`);
        context.lineWidth = shape.width;
        context.stroke();
        continue;
      }
      if (filled) {
        context.closePath();
        context.fillStyle = colour(`map-${name}`);
        context.fill("evenodd");
      }
      if (!width) continue;
      context.strokeStyle = colour(`map-${name}-edge`);
      context.lineWidth = width * metre;
      context.stroke();
    }
  }
}

/** A bar across each lane at its stop line. */
function drawLights({ context, colour, metre }, lights, step) {
  for (const [x, y, toX, toY, changes] of lights) {
    const state = lightAt(changes, step);
    if (!state) continue;
    const ends = [
      [x, y],
      [toX, toY],
    ];
    line(context, ends, colour("ground"), Math.max(1.1, 6 * metre));
    line(context, ends, colour(`light-${state}`), Math.max(0.8, 4 * metre));
  }
}

function drawPlan({ context, colour, metre }, plan, shown, number) {
  const picked =
    plan.candidates.find((one) => one.number === number) ?? plan.candidates[plan.chosen];
  if (shown.heat) {
    context.fillStyle = colour("heat");
    for (const [x, y, share] of plan.heat ?? []) {
      context.globalAlpha = 0.7 * share;
      context.fillRect(x - 0.5, y - 0.5, 1, 1);
    }
    context.globalAlpha = 1;
  }
  if (shown.candidates) {
    const most = Math.max(...plan.candidates.map((one) => one.value));
    for (const one of plan.candidates) {
      context.globalAlpha = most > 0 ? 0.3 + (0.5 * Math.max(one.value, 0)) / most : 0.4;
      line(context, one.path, colour("candidate"), 1 * metre);
    }
    context.globalAlpha = 1;
    if (picked) line(context, picked.path, colour("candidate"), 2.4 * metre);
  }
  if (shown.reactions && picked) {
    for (const one of picked.reactions) {
      context.globalAlpha = 0.3 + 0.7 * Math.min(1, one.p);
      line(
        context,
        one.path,
        colour("reaction"),
        (one.hits ? 2.2 : 1.1) * metre,
        one.hits ? [] : [4 * metre, 3 * metre],
      );
    }
    context.globalAlpha = 1;
  }
  drawPath({ context, colour, metre }, plan);
}

function drawPath({ context, colour, metre }, plan, role = "opponent") {
  line(context, plan.path, colour(role), 2.2 * metre, [6 * metre, 3 * metre]);
}

function line(context, points, colour, width, dash = []) {
  trace(context, points);
  context.setLineDash(dash);
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke();
  context.setLineDash([]);
}

/** The path driven so far, from the current step on. */
function drawDriven({ context, colour, metre }, scene, agent, step) {
  const points = [];
  for (let at = scene.now; at <= step + 1e-6; at += 1) {
    const pose = poseAt(agent, at);
    if (pose) points.push([pose.x, pose.y]);
  }
  line(context, points, colour(agent.role), 1.6 * metre);
}

/** A box with its front; hollow where the AV cannot see it. */
function drawAgent({ context, colour, metre }, agent, role, step, scores, hollow) {
  const pose = poseAt(agent, step);
  if (!pose) return;
  const grown = Math.max(1, (6 * metre) / agent.size[0]); // people would be too small to be seen
  const [length, width] = agent.size.map((side) => side * grown),
    score = scores[agent.id];
  context.save();
  context.translate(pose.x, pose.y);
  context.rotate(pose.heading);
  context.fillStyle =
    role !== "other"
      ? colour(role)
      : score === undefined
        ? colour("other")
        : scoreColour(score);
  context.strokeStyle = colour(role === "other" ? "other-edge" : hollow ? role : "contact");
  context.lineWidth = (hollow ? 1.6 : 1) * metre;
  context.beginPath();
  context.rect(-length / 2, -width / 2, length, width);
  if (!hollow) context.fill();
  if (hollow) context.setLineDash([2.5 * metre, 2 * metre]);
  context.stroke();
  context.setLineDash([]);
  context.beginPath(); // its front
  context.moveTo(length / 2, 0);
  context.lineTo(length / 4, width / 3);
  context.lineTo(length / 4, -width / 3);
  context.closePath();
  context.fillStyle = "rgba(255,255,255,0.75)";
  if (hollow) context.stroke();
  else context.fill();
  if (role === "opponent") drawStar({ context, colour, metre });
  context.restore();
}

function drawStar({ context, colour, metre }) {
  const radius = Math.max(0.9, 7 * metre);
  context.beginPath();
  for (let corner = 0; corner < 10; corner += 1) {
    const angle = Math.PI / 2 + (corner * Math.PI) / 5,
      reach = corner % 2 ? 0.42 * radius : radius;
    context.lineTo(reach * Math.cos(angle), reach * Math.sin(angle));
  }
  context.closePath();
  context.fillStyle = colour("star");
  context.strokeStyle = "#000000";
  context.lineWidth = 0.8 * metre;
  context.fill();
  context.stroke();
}

function drawContact({ context, colour, metre }, contact) {
  const [x, y] = contact.place,
    reach = 8 * metre;
  const stroke = (up, name, width) =>
    line(
      context,
      [
        [x - reach, y - up],
        [x + reach, y + up],
      ],
      colour(name),
      width * metre,
    );
  for (const [name, width] of Object.entries({ ground: 5, contact: 2.4 }))
    for (const up of [reach, -reach]) stroke(up, name, width);
}

function drawScale(context, ratio, height, scale, colour) {
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  const metres = [5, 10, 20, 50, 100, 200].find((one) => one * scale >= 60) ?? 500;
  context.strokeStyle = context.fillStyle = colour("ink");
  context.lineWidth = 2;
  trace(context, [
    [14, height - 14],
    [14 + metres * scale, height - 14],
  ]);
  context.stroke();
  context.font = "12px system-ui, sans-serif";
  context.fillText(`${metres} m`, 16, height - 19);
}
