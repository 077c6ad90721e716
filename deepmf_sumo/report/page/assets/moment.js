// The text about a moment and its plan.

function momentText(scene, step) {
  const driven = (agent, name) =>
    `${name} ${fixed(speedAt(agent, step), 1)} m/s (${driverAt(agent, step)})`;
  const parts = [`${((step - scene.now) * scene.dt).toFixed(1)} s`, driven(scene.av, "AV")];
  for (const attacker of attackersAt(scene, step))
    if (attacker.drivers) parts.push(driven(attacker, "opponent"));
    else parts.push(`opponent: vehicle ${attacker.id}`);
  if (scene.onset !== null && Math.round(step) === scene.onset) parts.push("onset: the danger shows");
  const conflict = conflictAt(scene, step);
  if (conflict) {
    const ttc = conflict.ttc === null ? "above 10 s or none" : `${fixed(conflict.ttc, 1)} s`;
    parts.push(`gap ${fixed(conflict.gap, 1)} m`, `TTC ${ttc}`);
  }
  const unseen = unseenAt(scene, step);
  if (unseen.length) parts.push(`hidden from the AV: ${unseenText(scene, unseen)}`);
  for (const { first, second, speed } of scene.contacts.filter((contact) => step >= contact.step))
    parts.push(`contact of ${first} and ${second} at ${speed.toFixed(1)} m/s relative speed`);
  return parts.join(" · ");
}

/** Hidden road users: the attackers first, the others by their number. */
function unseenText(scene, unseen) {
  const main = unseen.filter((agent) => scene.main.includes(agent)).map((agent) => agent.id);
  const others = unseen.length - main.length;
  const rest = counted(others, main.length ? "other" : "road user", main.length ? "others" : "road users");
  return [...main, ...(others ? [rest] : [])].join(", ");
}

/** What is known of a plan, and the choice of the candidate whose reactions are drawn. */
function planElements(scene, plan, pick) {
  const title = make(
    "h3",
    {},
    plan ? `Plan at ${((plan.step - 1 - scene.now) * scene.dt).toFixed(1)} s` : "No plan yet",
  );
  if (!plan) return [title];
  if (!plan.rule) return [title, make("p", { class: "hint" }, "It gives no reasons.")];
  const chosen = plan.candidates[plan.chosen];
  const label = (number) => {
    const one = plan.candidates.find((candidate) => String(candidate.number) === number);
    return `${one === chosen ? "chosen: " : ""}no. ${number}${one.origin ? `, ${one.origin}` : ""}, value ${digits(one.value)}`;
  };
  const byValue = [...plan.candidates].sort(
    (one, other) => (other === chosen) - (one === chosen) || other.value - one.value,
  );
  const facts = {
    rule: plan.rule,
    candidates: `${plan.candidates.length} of ${plan.of} on this page`,
    "P(candidate)": digits(chosen.p),
    value: digits(chosen.value),
    ...(chosen.hit === undefined ? {} : { "P(AV's reaction collides)": chosen.hit.toFixed(3) }),
    ...(plan.unmet.length ? { "unmet wishes": plan.unmet.join(", ") } : {}),
  };
  return [
    title,
    definitions(facts),
    make(
      "label",
      {},
      "Reactions to candidate ",
      choice(
        byValue.map((one) => String(one.number)),
        String(chosen.number),
        (value) => pick(Number(value)),
        label,
      ),
    ),
    make("p", { class: "hint" }, "All modes for the chosen candidate; the likeliest one for the others."),
  ];
}
