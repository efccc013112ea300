
// The page: state in the address, tabs, table, charts.

const data = JSON.parse($("data").textContent);
const ABOUT = {
  paths: "Planners move the arm from one configuration to another in a given time. The score is the energy their path leaves in the base, over that of the straight joint line on the same query.",
  policies: "Policies and controllers drive the arm in an environment, on the same episodes for everyone.",
  tasks: "Solve what the task asks of an episode, and then move its base as little as can be. Who solves clearly more ranks above whoever solves less, whatever the energies. E_mean is of all episodes, solved or not: who does nothing moves no base and solves nothing.",
  damping: "Joint gains, controllers and policies that take vibration out of the base.",
  discrepancy: "Naming what a description of the machine lacks, from logs, on the blind benchmark. A case is answered as wanted or not; “always nothing” and “location only”, which name nothing, show what that is worth.",
};
const QUESTION = $("question").textContent; // of planners and policies
const QUESTIONS = {
  tasks: "Who does what is asked and leaves the base at rest?",
  damping: "Who brings a base that vibrates to rest?",
  discrepancy: "Who says what the description of a machine lacks?",
};
// how tracks with classes of success rank (docs/leaderboard/statistics.md)
const RULE = " An episode that is not solved has none and counts as the worst. Ranked by class of success first, then by score: "
  + "class 1 are those than whom nobody solves clearly more (their 95 % intervals of success overlap), class 2 these of the rest, and so on.";
const SHOWN = 6; // curves in the charts
const FIRST = 100; // rows shown until all are asked for

// --------------------------------------------------------------------------- state

const state = { track: "", problem: "", seeds: "", sort: "rank", filter: "", kind: "", open: "" };

/** Read the address; what it does not hold, or holds wrongly, takes its default. */
function readState() {
  const given = new URLSearchParams(location.hash.slice(1));
  for (const key of Object.keys(state)) state[key] = given.get(key) ?? "";
  if (!track()) state.track = data.tracks[0]?.track ?? "";
  const groups = track()?.groups ?? [];
  if (!groups.some((g) => g.problem === state.problem)) state.problem = groups[0]?.problem ?? "";
  const here = groups.filter((g) => g.problem === state.problem);
  const count = (seeds) => here.find((g) => g.seeds === seeds)?.entries.length ?? 0;
  // official rows cannot have been fitted to: the latest season's come first where they are not few beside the others
  const season = here.map((g) => g.seeds).filter((seeds) => seeds.startsWith("official")).sort().at(-1);
  const first = 2 * count(season) >= count("public") && season ? season : "public";
  if (!here.some((g) => g.seeds === state.seeds)) state.seeds = count(first) ? first : here[0]?.seeds ?? "";
  if (!COLUMNS.some(({ key }) => key === state.sort.replace(/^-/, ""))) state.sort = "rank";
}

/** Change the state and write it to the address. */
function go(change, draw = drawAll) {
  Object.assign(state, change);
  const kept = Object.entries(state).filter(([key, value]) => value !== "" && !(key === "sort" && value === "rank"));
  const hash = `#${new URLSearchParams(kept)}`;
  if (hash !== location.hash) history.replaceState(null, "", hash);
  draw();
}

const track = () => data.tracks.find((t) => t.track === state.track);
const group = () => track()?.groups.find((g) => g.problem === state.problem && g.seeds === state.seeds);

// ------------------------------------------------------------------------- numbers

/** A number of an entry; what is infinite failed too often. */
const amount = (value) => (value === null ? "∞" : number(value));
const range = ([, low, high]) => `${amount(low)} to ${amount(high)}`;
const place = ([value, low, high]) => (low === high && low === value ? "" : `${low}–${high}`);
const share = (value) => `${Math.round(100 * value)} %`;
const orDash = (value) => (value === undefined ? "–" : amount(value)); // no row has it
const versionsOf = (e) => ["ves_gym", "mujoco"].filter((k) => e.about.versions?.[k])
  .map((k) => `${k} ${e.about.versions[k]}`).join(", ");
const withSub = (text, sub) => [text, sub ? el("span", { class: "sub" }, sub) : null];

// --------------------------------------------------------------------------- table

// key, heading, unit, what it is sorted by, cells; numbers are set right
const COLUMNS = [
  { key: "rank", name: "rank", css: "rank", by: (e) => e.rank[0],
    cell: (e) => withSub(String(e.rank[0]), place(e.rank)) },
  { key: "name", name: "entry", css: "who", by: (e) => e.name.toLowerCase(), cell: nameCell },
  { key: "kind", name: "kind", by: (e) => e.kind, cell: (e) => [e.kind] },
  { key: "class", name: "class", css: "number", by: (e) => e.class, cell: (e) => [String(e.class)] },
  { key: "score", name: "score", css: "number main", by: (e) => e.score[0],
    cell: (e) => withSub(amount(e.score[0]), finite(e.score[0]) ? range(e.score) : e.class ? "solves too few" : "fails too often") },
  { key: "bar", name: "95 % interval", css: "picture", cell: (e) => [scoreBar(e.score, shown.axis)] },
  { key: "success", name: "success", css: "number", by: (e) => e.success[0],
    cell: (e) => withSub(share(e.success[0]), `${share(e.success[1])} to ${share(e.success[2])}`) },
  { key: "over", name: "E over reference", unit: () => shown.group.entries.find((e) => e.over)?.over.law,
    css: "number", by: (e) => e.over?.ratio[0],
    cell: (e) => (e.over ? withSub(amount(e.over.ratio[0]), `${range(e.over.ratio)}, n ${e.over.episodes}`) : ["–"]) },
  ...["E_mean", "E_decay", "E_peak", "E_res"].map((key) => ({
    key, name: key, unit: "J", css: "number", by: (e) => e[key], cell: (e) => [orDash(e[key])],
  })),
  { key: "seconds", name: "time", unit: "s", css: "number", by: (e) => e.seconds, cell: (e) => [orDash(e.seconds)] },
  { key: "seeds", name: "seeds", css: "number", by: (e) => e.training_seeds,
    cell: (e) => withSub(`${e.episodes}${e.training_seeds > 1 ? ` × ${e.training_seeds}` : ""}`, state.seeds.split(" ")[0]) },
  { key: "versions", name: "versions", by: versionsOf, cell: (e) => withSub(...versionLines(e)) },
  { key: "bundle", name: "bundle", by: (e) => e.bundle,
    cell: (e) => [e.bundle ? el("code", { title: e.bundle }, e.bundle.slice(0, 8)) : "–"] },
];

function versionLines(e) {
  const [first, ...rest] = versionsOf(e).split(", ");
  return [first, rest.join(", ")];
}

function nameCell(e) {
  const button = el("button", { type: "button", title: e.name, "aria-expanded": "false" }, e.name);
  button.addEventListener("click", () => {
    const open = button.getAttribute("aria-expanded") !== "true";
    go({ open: open ? e.ids[0] : "" }, drawTable);
  });
  return [button, e.author ? el("span", { class: "sub", title: e.author }, e.author) : null];
}

const shown = { group: null, all: false, columns: [], axis: null, rows: new Map(), words: new Map(), entries: [] };

/** Rows of a group are made once, and only put in order after that. */
function prepare(g) {
  if (shown.group === g) return;
  Object.assign(shown, { group: g, all: false, axis: barAxis(g), rows: new Map(), words: new Map() });
  // success comes first where it ranks
  const columns = g.entries[0].class ? bySuccess(COLUMNS) : COLUMNS;
  // energies of what moves nothing, times of what plans nothing, a kind that all are of: such
  // columns are left out
  const kinds = new Set(g.entries.map((e) => e.kind)).size;
  shown.columns = columns.filter(({ key, by }) => (key !== "kind" || kinds > 1)
    && (!by || g.entries.some((e) => by(e) !== undefined)));
  for (const e of g.entries) {
    shown.words.set(e, [e.name, e.author, e.kind, e.bundle, versionsOf(e), e.about.cpu].join(" ").toLowerCase());
  }
}

function bySuccess(columns) {
  const first = ["rank", "name", "kind", "class", "success"];
  return [...first.map((key) => columns.find((c) => c.key === key)), ...columns.filter(({ key }) => !first.includes(key))];
}

function rowOf(e) {
  if (!shown.rows.has(e)) {
    const line = el("tr", { class: e.rank[0] === 1 ? "entry best" : "entry", "data-id": e.ids[0] });
    for (const { key, css, cell } of shown.columns) {
      line.append(key === "name" ? el("th", { scope: "row", class: css }, ...cell(e))
        : el("td", { class: css ?? null, "data-key": key }, ...cell(e)));
    }
    shown.rows.set(e, line);
  }
  return shown.rows.get(e);
}

/** Entries that match every word of the filter, sorted; what has no number comes last. */
function selected(g) {
  const terms = state.filter.toLowerCase().split(/\s+/).filter(Boolean);
  const some = g.entries.filter((e) => terms.every((term) => shown.words.get(e).includes(term))
    && (!state.kind || e.kind === state.kind));
  const { by } = COLUMNS.find(({ key }) => key === state.sort.replace(/^-/, ""));
  const sign = state.sort.startsWith("-") ? -1 : 1;
  const missing = (value) => value === null || value === undefined;
  return some.map((e, k) => [by(e), k, e]).sort(([a, i], [b, j]) => {
    if (missing(a) || missing(b)) return missing(a) - missing(b) || i - j;
    return (typeof a === "string" ? sign * a.localeCompare(b) : sign * (a - b)) || i - j;
  }).map(([, , e]) => e);
}

function drawHead() {
  const line = el("tr");
  for (const { key, name, unit, css, by } of shown.columns) {
    const th = el("th", { scope: "col", class: css ?? null, "data-key": key });
    if (by) {
      const button = el("button", { type: "button" }, symbol(name));
      button.addEventListener("click", () => sortBy(key));
      th.append(button);
    } else th.append(name);
    th.append(el("span", { class: "unit" }, key === "bar" ? barUnit() : (unit?.call ? unit() : unit) ?? "\u00a0"));
    line.append(th);
  }
  $("table").replaceChildren(el("thead", {}, line), el("tbody"));
}

/** Say in the headings what the table is sorted by. */
function drawOrder() {
  const [down, sorted] = [state.sort.startsWith("-"), state.sort.replace(/^-/, "")];
  for (const th of $("table").tHead.rows[0].cells) {
    if (!th.querySelector("button")) continue;
    th.setAttribute("aria-sort", th.dataset.key !== sorted ? "none" : down ? "descending" : "ascending");
  }
}

const barUnit = () => (shown.axis === null ? "\u00a0"
  : `${number(shown.axis.from, 2)} to ${number(shown.axis.to, 2)}${shown.axis.log ? ", log" : ""}`);

function sortBy(key) {
  go({ sort: state.sort === key ? `-${key}` : key }, () => { drawTable(); drawCharts(); });
}

function drawTable() {
  const g = group();
  drawOrder();
  shown.entries = selected(g);
  const lines = [];
  const visible = shown.all ? shown.entries : shown.entries.slice(0, FIRST);
  for (const e of visible) {
    const line = rowOf(e);
    const open = state.open === e.ids[0];
    line.querySelector("th button").setAttribute("aria-expanded", open);
    lines.push(line);
    if (open) lines.push(detail(e));
  }
  if (!lines.length) lines.push(el("tr", {}, el("td", { colspan: shown.columns.length }, "No entry matches.")));
  const focused = document.activeElement;
  $("table").tBodies[0].replaceChildren(...lines);
  // a row that was moved has lost it
  if (focused !== document.activeElement && focused.isConnected) focused.focus({ preventScroll: true });
  $("count").textContent = `${shown.entries.length} of ${g.entries.length} entries`;
  $("more").hidden = visible.length === shown.entries.length;
  $("more").textContent = `Show all ${shown.entries.length}`;
}

/** All that is known of an entry. */
function detail(e) {
  const { about } = e;
  const json = (value) => (value && Object.keys(value).length ? el("pre", {}, JSON.stringify(value, null, 1)) : null);
  const facts = [
    ["score", `${amount(e.score[0])} (95 %: ${range(e.score)})`],
    ["by training seed", e.by_training_seed.map(amount).join(", ")],
    ["in most episodes the same as", e.same.join(", ")],
    ["failed", e.failed ? `${e.failed} of ${e.episodes * e.training_seeds}` : "none"],
    ["cost evaluations", e.evaluations === undefined ? "" : amount(e.evaluations)],
    ["bundle (SHA-256)", e.bundle && el("code", {}, e.bundle)],
    ["entry", el("code", {}, e.ids.join(", "))],
    ["versions", Object.entries(about.versions ?? {}).map((pair) => pair.join(" ")).join(", ")],
    ["processor", [about.cpu, about.simd].filter(Boolean).join("; ")],
    ["model (SHA-256)", about.model && el("code", {}, about.model)],
    ["evaluator (SHA-256)", about.evaluator && el("code", {}, about.evaluator)],
    ["author's key", about.key && el("code", {}, about.key)],
    ["submitted run", about.reproduction && `${about.reproduction.equal} of ${about.reproduction.rows} scores equal to the `
      + `last bit, largest difference ${number(about.reproduction.largest)}`],
    ["settings", json(about.settings)],
    ["training", json(about.training)],
    ["evaluated", about.begun ? `${about.begun} to ${about.ended}` : ""],
  ].filter(([, value]) => value);
  return el("tr", { class: "detail" }, el("td", { colspan: shown.columns.length },
    el("dl", {}, ...facts.flatMap(([term, value]) => [el("dt", {}, term), el("dd", {}, value)]))));
}

// -------------------------------------------------------------------------- charts

// a planner's own, else by rank: an entry keeps its colour however the table is sorted
const styleOf = (k) => {
  const name = group().entries[k]?.name;
  return Object.hasOwn(STYLES, name) ? STYLES[name] : [1 + (k % 6), DASHES[Math.floor(k / 6) % DASHES.length]];
};
const tone = (k) => `var(--s${styleOf(k)[0]})`;
const dashOf = (k) => styleOf(k)[1];

function mark(k) {
  return svg("svg", { class: "swatch", viewBox: "0 0 22 12", "aria-hidden": "true" }, svg("line", {
    x1: 0, x2: 22, y1: 6, y2: 6, "stroke-width": 3, "stroke-dasharray": dashOf(k), style: `stroke:${tone(k)}`,
  }));
}

function drawCharts() {
  const g = group();
  const some = shown.entries.slice(0, SHOWN).map((e) => [e, g.entries.indexOf(e)]);
  $("charts").hidden = some.length === 0 || !(g.profiles || g.anytime);
  if ($("charts").hidden) return;
  $("shown-note").textContent = shown.entries.length > SHOWN
    ? `The first ${SHOWN} rows of the table, as it is sorted and filtered.` : "";
  const values = some.map(() => el("span", { class: "value" }));
  $("legend").replaceChildren(...some.map(([e, k], i) => el("span", {}, mark(k),
    el("span", { class: "name", title: e.name }, e.name), values[i])));
  const told = (texts) => values.forEach((node, i) => { node.textContent = texts?.[i] ?? ""; });
  $("profile-figure").hidden = !g.profiles;
  // the profile is as wide as what stands beside it leaves
  $("anytime-figure").hidden = !g.anytime || some.every(([, k]) => !g.anytime.curves[k]);
  if (g.profiles) drawProfile(g, some, told);
  if (!$("anytime-figure").hidden) drawAnytime(g, some, told);
}

function drawProfile(g, some, told) {
  const { at, curves } = g.profiles;
  const chart = {
    at, log: at[0] > 0 && at.at(-1) / at[0] > 5, range: [0, 1], percent: true, x: scoreName(g),
    curves: some.map(([, k]) => {
      const [value, low, high] = curves[k];
      return { colour: tone(k), dash: dashOf(k), value, low, high };
    }),
  };
  drawChart($("profile"), chart, (k) => {
    $("profile-now").textContent = k === null ? "" : `score ≤ ${number(at[k])}`;
    told(k === null ? null : chart.curves.map((c) => share(c.value[k])));
  });
}

function drawAnytime(g, some, told) {
  const dots = some.map(([e, k]) => (g.anytime?.curves[k] ? null : [e.seconds, e.score[0]]));
  const times = dots.filter((d) => d && finite(d[0]) && d[0] > 0).map((d) => d[0]);
  const at = g.anytime.at;
  const wide = [Math.min(at[0], ...times), ...at, Math.max(at.at(-1), ...times)];
  const curves = some.map(([, k], i) => {
    const value = g.anytime.curves[k];
    // level after the last time; nothing before the first
    return { colour: tone(k), dash: dashOf(k), value: value && [null, ...value, value.at(-1)], dot: dots[i] };
  });
  const scores = curves.flatMap((c) => [...(c.value ?? []), ...(c.dot ? [c.dot[1]] : [])]).filter(finite);
  const [low, high] = [Math.min(...scores), Math.max(...scores)];
  const yLog = low > 0 && high / low > 5;
  const chart = {
    at: wide, log: true, yLog, curves, x: "planning time [s]",
    range: yLog ? [low / 1.1, high * 1.1] : [Math.min(0, low), 1.05 * high],
  };
  drawChart($("anytime"), chart, (k) => {
    $("anytime-now").textContent = k === null ? "" : `after ${number(wide[k])} s`;
    told(k === null ? null : curves.map((c) => (c.value && finite(c.value[k]) ? number(c.value[k]) : "–")));
  });
}

// --------------------------------------------------------------------- improvement

function drawImprovement() {
  const g = group();
  const n = g.improvement.length;
  $("improvement-section").hidden = n < 2;
  if (n < 2) return;
  $("improvement-note").textContent = "Probability that the entry of the row scores lower than that of the column "
    + "on the same episode, in percent, with its 95 % interval. Bold: the interval leaves out 50."
    + (g.entries.length > n ? ` The first ${n} by rank.` : "");
  const head = el("tr", {}, el("th", { scope: "col" }, "P(better)"), ...g.improvement.map((_, k) => el("th",
    { scope: "col", title: g.entries[k].name }, String(k + 1))));
  const body = el("tbody", {}, ...g.improvement.map((_, i) => el("tr", {},
    el("th", { scope: "row", title: g.entries[i].name }, `${i + 1}  ${g.entries[i].name}`),
    ...g.improvement.map((__, j) => chance(pairOf(g, i, j))))));
  $("improvement").replaceChildren(el("thead", {}, head), body);
}

/** Only pairs above the diagonal are in the data; the others are their complements. */
function pairOf(g, i, j) {
  if (i === j) return null;
  if (i < j) return g.improvement[i][j - i - 1];
  const [value, low, high] = g.improvement[j][i - j - 1];
  return [1 - value, 1 - high, 1 - low];
}

function chance(pair) {
  if (pair === null) return el("td", { class: "self" });
  const [value, low, high] = pair.map((k) => Math.round(100 * k));
  const style = `--share:${Math.abs(2 * pair[0] - 1) * 34};--tone:var(${pair[0] > 0.5 ? "--s4" : "--s1"})`;
  return el("td", { style, class: pair[1] > 0.5 || pair[2] < 0.5 ? "sure" : null },
    ...withSub(String(value), low === high ? "" : `${low}–${high}`));
}

// ------------------------------------------------------------------- tabs and heads

function scoreName(g) {
  return g.score.unit === "1" ? g.score.name : `${g.score.name} [${g.score.unit}]`;
}

function drawTabs() {
  $("tabs").replaceChildren(...data.tracks.map((t) => {
    const here = t.track === state.track;
    const tab = el("button", {
      type: "button", role: "tab", id: `tab-${t.track}`, "aria-selected": String(here), "aria-controls": "panel",
      tabindex: here ? 0 : -1,
    }, t.title, el("span", { class: "n" }, String(entriesOf(t))));
    tab.addEventListener("click", () => openTrack(t));
    return tab;
  }));
  $("question").textContent = QUESTIONS[state.track] ?? QUESTION;
  $("panel").setAttribute("aria-labelledby", `tab-${state.track}`);
}

const entriesOf = (t) => new Set(t.groups.flatMap((g) => g.entries.flatMap((e) => e.ids))).size;

function openTrack(t, focus = document.activeElement?.getAttribute("role") === "tab") {
  go({ track: t.track, problem: "", seeds: "", sort: "rank", kind: "", open: "" }, () => {});
  readState();
  drawAll();
  if (focus) $(`tab-${t.track}`).focus();
}

$("tabs").addEventListener("keydown", (event) => {
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  const n = data.tracks.length;
  const here = data.tracks.findIndex((t) => t.track === state.track);
  const next = step ? (here + step + n) % n : { Home: 0, End: n - 1 }[event.key];
  if (next === undefined) return;
  event.preventDefault();
  openTrack(data.tracks[next], true);
});

function drawProblems() {
  const names = [...new Set(track().groups.map((g) => g.problem))];
  $("problems").replaceChildren(...names.map((name) => {
    const here = name === state.problem;
    const button = el("button", { type: "button", "aria-pressed": String(here) }, name);
    button.addEventListener("click", () => {
      go({ problem: name, seeds: "", open: "" }, () => {});
      readState();
      drawAll();
      [...$("problems").children].find((b) => b.textContent === name).focus();
    });
    return button;
  }));
  const here = $("problems").querySelector("[aria-pressed=true]");
  $("problems").scrollLeft = here.offsetLeft - $("problems").offsetLeft - 16;
}

function drawChoices() {
  const g = group();
  const options = (id, values, all) => {
    const wanted = all === null ? values : ["", ...values];
    $(id).replaceChildren(...wanted.map((value) => el("option", { value }, value || all)));
    $(id).value = state[id];
    if ($(id).selectedIndex < 0) $(id).value = state[id] = "";
    $(id).closest("label").hidden = values.length < 2;
  };
  options("kind", [...new Set(g.entries.map((e) => e.kind))].sort(), "all");
  options("seeds", track().groups.filter((k) => k.problem === state.problem).map((k) => k.seeds), null);
  if ($("filter").value !== state.filter) $("filter").value = state.filter;
}

function drawVerdict() {
  const g = group();
  const first = g.entries.filter((e) => e.rank[0] === 1);
  const [lead] = first;
  const unit = g.score.unit === "1" ? "" : ` ${g.score.unit}`;
  const others = g.entries.filter((e) => e.rank[0] > 1 && e.rank[1] === 1);
  const rest = others.length ? ` not settled against ${others.length === 1 ? others[0].name : `${others.length} others`}.` : "";
  const whole = (text) => el("span", { class: "whole" }, text); // not broken where it fits a line
  const problem = whole(`${state.problem}:`);
  $("verdict").replaceChildren(...finite(lead.score[0]) ? [
    el("em", {}, listed(first.map((e) => e.name))), first.length > 1 ? " lead " : " leads ", problem, " ",
    lead.class ? whole(`solves ${share(lead.success[0])} (${share(lead.success[1])} to ${share(lead.success[2])}) with`) : "", " ",
    whole(`${number(lead.score[0])}${unit}`), " ", whole(`(95 %: ${range(lead.score)})${rest ? "," : "."}`), rest,
  ] : [problem, " nobody has a finite score."]);
  $("about").textContent = ABOUT[state.track];
  $("score-name").textContent = `Score: ${scoreName(g)}, ${g.statistic === "iqm" ? "interquartile mean" : "mean"}.${lead.class ? RULE : ""}`;
}

function drawAll() {
  drawTabs();
  if (!group()) return;
  prepare(group());
  drawProblems();
  drawChoices();
  drawVerdict();
  drawHead();
  drawTable();
  drawCharts();
  drawImprovement();
}

// --------------------------------------------------------------------------- start

function drawFrame() {
  $("eyebrow").textContent = ["Leaderboard of ves_gym", `${data.entries} ${data.entries === 1 ? "entry" : "entries"}`,
    ...(data.newest ? [`newest ${data.newest.slice(0, 10)}`] : []), `hash ${data.head.slice(0, 12)}`].join(" · ");
  $("nothing").hidden = data.tracks.length > 0;
  $("panel").hidden = $("tabs").hidden = data.tracks.length === 0;
  if (data.tracks.length === 0) $("verdict").textContent = "The board is empty.";
  for (const { id, name, problem, why } of data.unranked) {
    $("unranked").append(el("li", {}, `${name} on ${problem} (${id}): ${why}.`));
  }
  $("unranked-section").hidden = data.unranked.length === 0;
  drawUnranked("shown", data.shown, "why");
  drawUnranked("history", data.history, "version");
  const facts = [
    ["Entries", `${data.entries} files, only added to; git has their history`],
    ["Hash of all", el("code", {}, data.head)],
    ["Protocols", data.tracks.map((t) => `${t.title.toLowerCase()} ${t.protocol}`).join(", ") || "–"],
    ["Schema", el("code", {}, data.schema)],
  ];
  for (const [term, value] of facts) $("provenance").append(el("dt", {}, term), el("dd", {}, value));
}

/** Entries without a rank: replayed only, or of older versions, with nobody to rank them with. */
function drawUnranked(id, entries, last) {
  $(`${id}-section`).hidden = entries.length === 0;
  const head = el("tr", {}, ...["problem", "entry", "score", "level", "entry", last].map((name) => el("th", { scope: "col" }, name)));
  const body = entries.map((e) => el("tr", {}, el("td", {}, ...withSub(e.problem, e.track)),
    el("th", { scope: "row", class: "who" }, ...withSub(e.name, e.author)),
    el("td", { class: "number" }, ...(e.score ? withSub(amount(e.score[0]), range(e.score)) : ["–"])),
    el("td", {}, e.level), el("td", {}, el("code", {}, e.id)), el("td", {}, e.why)));
  $(id).replaceChildren(el("thead", {}, head), el("tbody", {}, ...body));
}

function filtered() {
  go({ filter: $("filter").value.trim(), kind: $("kind").value }, () => { drawTable(); drawCharts(); });
}

$("filter").addEventListener("input", filtered);
$("more").addEventListener("click", () => {
  shown.all = true;
  drawTable();
});
$("kind").addEventListener("change", filtered);
$("seeds").addEventListener("change", () => go({ seeds: $("seeds").value, open: "" }));
$("skip").addEventListener("click", (event) => { // the address holds the state
  event.preventDefault();
  $("main").focus();
});
addEventListener("hashchange", () => {
  readState();
  drawAll();
});
drawFrame();
readState();
redrawn(drawAll);
