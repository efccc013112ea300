// Shared by the scripts that follow in this module: what was found.

const BASELINE = "straight";
const EMULATED = data.mode === "emulated";

const ratioText = (value) => (value === null ? "–" : `${number(value, 2)} ×`);

/** Fill a selector; false (and the section says so) when there is nothing to select. */
function choices(section, select, labels, what) {
  if (labels.length === 0) {
    const rest = [...$(section).children].slice(1);
    rest.forEach((node) => node.setAttribute("hidden", "")); // an SVG has no .hidden
    $(section).append(el("p", { class: "note" }, `This result holds no ${what}.`));
    return false;
  }
  labels.forEach((label, k) => select.append(el("option", { value: k }, label)));
  select.disabled = labels.length === 1;
  return true;
}

const caseLabel = (item) => `${item.vehicle} · T = ${item.duration} s · ${item.query}`;

// ---------------------------------------------------------------------- verdict

/** Summary rows by vehicle and duration, in the order they come. */
function cases() {
  const groups = new Map();
  for (const row of data.summary ?? []) {
    const key = JSON.stringify([row.vehicle, row.duration]);
    if (!groups.has(key)) groups.set(key, { vehicle: row.vehicle, duration: row.duration, rows: [] });
    groups.get(key).rows.push(row);
  }
  return [...groups.values()];
}

/** Whether a summary row has a ratio. */
const rated = (row) => row?.ratio_median > 0;

/** The row of least ratio among those that have one, or null. */
function least(rows) {
  const some = rows.filter(rated);
  return some.length ? some.reduce((a, b) => (b.ratio_median < a.ratio_median ? b : a)) : null;
}

/** The planner whose median ratios have the least geometric mean, over all cases. */
function winner(groups) {
  let best = null;
  for (const name of names.filter((n) => n !== BASELINE)) {
    const rows = groups.map((group) => group.rows.find((row) => row.planner === name));
    if (!rows.every(rated) || rows.length === 0) continue;
    const level = rows.reduce((sum, row) => sum + Math.log(row.ratio_median), 0) / rows.length;
    if (best === null || level < best.level) best = { name, rows, level };
  }
  return best;
}

function verdict(groups) {
  if (groups.length === 0) return "This result holds no runs.";
  const best = winner(groups);
  if (best === null && data.rows.some((row) => row.stopped)) {
    return "No planner finished every case: the platform stopped.";
  }
  if (best === null) return "Only the straight line was run: there is nothing to compare it with.";
  const one = new Set(groups.map((group) => group.vehicle)).size === 1;
  const ratios = best.rows.map((row) => number(row.ratio_median, 2));
  const where = one
    ? `${listed(ratios)} × the energy of the straight line at T = `
      + `${listed(groups.map((group) => String(group.duration)))} s`
    : `${listed(best.rows.map((row, k) =>
      `${ratios[k]} × (${row.vehicle}, T = ${row.duration} s)`))} the energy of the straight line`;
  if (best.level < 0) return `${best.name} transfers ${where}.`;
  const all = best.rows.every((row) => row.ratio_median >= 1);
  return `No planner beats the straight line${all ? "" : " throughout"}: ${best.name}, on average the`
    + ` best, transfers ${where}.`;
}

function tile(group) {
  const best = least(group.rows);
  if (best === null) {
    return el("div", { class: "tile", style: "--colour:var(--soft)" },
      el("div", { class: "case" }, `${group.vehicle} · T = ${group.duration} s`),
      el("div", { class: "big" }, "–"), el("div", { class: "detail" }, "nothing to compare"));
  }
  const failed = best.success_rate < 1 ? ` · ${percent(1 - best.success_rate)} failed` : "";
  const interval = best.ratio_low === best.ratio_high ? ""
    : `95 %: ${span(best.ratio_low, best.ratio_high)} · `;
  const queries = `${best.n} ${best.n === 1 ? "query" : "queries"}`;
  return el("div", { class: "tile", style: `--colour:${colour(best.planner)}` },
    el("div", { class: "case" }, `${group.vehicle} · T = ${group.duration} s`),
    el("div", { class: "big" }, ratioText(best.ratio_median)),
    el("div", { class: "who" }, best.planner),
    el("div", { class: "detail" }, `${interval}${queries}${failed}`));
}

function provenance() {
  const count = (data.rows ?? []).length;
  const entries = [
    ["Command", el("code", {}, data.command || "–")],
    ["Suite", `${data.suite ?? "–"}${data.quick ? " (quick)" : ""}, ${count} ${count === 1 ? "run" : "runs"}`],
    ["Mode, drive", `${data.mode ?? "–"}, ${data.drive ?? "–"}`],
    ["Seed", String(data.seed ?? "–")],
    ["Created", data.created ?? "–"],
    ["Took", `${number(data.seconds)} s`],
    ["Versions", Object.entries(data.versions ?? {}).map((pair) => pair.join(" ")).join(", ")],
    ["Schema", el("code", {}, data.schema)],
  ];
  for (const [name, system] of Object.entries(data.systems ?? {})) {
    const hash = el("code", {}, system.hash);
    entries.push([`System ${name}`, el("span", {}, `${system.description} `, hash)]);
  }
  for (const [term, text] of entries) $("provenance").append(el("dt", {}, term), el("dd", {}, text));
}

{
  const groups = cases();
  $("eyebrow").textContent = [
    `Path benchmark, suite ${data.suite ?? "–"}${data.quick ? " (quick)" : ""}`,
    `${data.mode ?? "–"} mode`, `${data.drive ?? "–"} drive`, (data.created ?? "").slice(0, 10),
  ].join(" · ");
  $("verdict").textContent = verdict(groups);
  $("tiles").append(...groups.map(tile));
  for (const { name, summary } of data.planners ?? []) {
    $("planners").append(el("dt", {}, swatch(name), name), el("dd", {}, summary));
  }
  for (const [term, text] of Object.entries(data.machine ?? {})) {
    $("machine").append(el("dt", {}, term), el("dd", {}, text));
  }
  for (const { vehicle, duration, n, rho_median: rho } of data.rank_correlation ?? []) {
    $("machine").append(el("dt", {}, "ranking of planners"), el("dd", {},
      `${vehicle}, T = ${duration} s: rank correlation with space ${number(rho)} (median of ${n} queries)`));
  }
  for (const run of (data.rows ?? []).filter((row) => row.stopped)) {
    $("stops").append(el("li", {}, `${run.vehicle}, ${run.query}, ${run.planner}: ${run.stopped}`));
  }
  $("laboratory").hidden = !EMULATED;
  provenance();
}
