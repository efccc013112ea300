// The page: state in the address, tabs, table.

const data = JSON.parse($("data").textContent);
const ABOUT = {
  paths: "Planners move the arm from one configuration to another in a given time. The score is the energy their path leaves in the base, over that of the straight joint line on the same query.",
  tasks: "Solve what the task asks of an episode, and then move its base as little as can be. Who solves clearly more ranks above whoever solves less, whatever the energies. E_mean is of all episodes, solved or not: who does nothing moves no base and solves nothing.",
  damping: "Joint gains, controllers and policies that take vibration out of the base.",
};
const QUESTION = $("question").textContent; // of planners
const QUESTIONS = {
  tasks: "Who does what is asked and leaves the base at rest?",
  damping: "Who brings a base that vibrates to rest?",
};
// how tracks with classes of success rank (docs/leaderboard/statistics.md)
const RULE = " An episode that is not solved has none and counts as the worst. Ranked by class of success first, then by score.";
const finite = (value) => typeof value === "number" && Number.isFinite(value);

// --------------------------------------------------------------------------- state

const state = { track: "", problem: "", seeds: "", sort: "rank", filter: "", open: "" };

/** Read the address; what it does not hold, or holds wrongly, takes its default. */
function readState() {
  const given = new URLSearchParams(location.hash.slice(1));
  for (const key of Object.keys(state)) state[key] = given.get(key) ?? "";
  if (!track()) state.track = data.tracks[0]?.track ?? "";
  const groups = track()?.groups ?? [];
  const count = (g) => g?.entries.length ?? 0;
  if (!groups.some((g) => g.problem === state.problem)) { // where most was compared
    state.problem = groups.reduce((a, b) => (count(b) > count(a) ? b : a), groups[0])?.problem ?? "";
  }
  const here = groups.filter((g) => g.problem === state.problem);
  // official rows cannot have been fitted to: they come first where they are not few
  const official = here.find((g) => g.seeds !== "public");
  const open = here.find((g) => g.seeds === "public");
  const first = official && 2 * count(official) >= count(open) ? official : open;
  if (!here.some((g) => g.seeds === state.seeds)) state.seeds = (first ?? here[0])?.seeds ?? "";
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
const orDash = (value) => (value === undefined ? "–" : amount(value)); // no episode has it
const withSub = (text, sub) => [text, sub ? el("span", { class: "sub" }, sub) : null];

// --------------------------------------------------------------------------- table

// key, heading, unit, what it is sorted by, cells; numbers are set right
const COLUMNS = [
  { key: "rank", name: "rank", css: "rank", by: (e) => e.rank[0],
    cell: (e) => withSub(String(e.rank[0]), place(e.rank)) },
  { key: "name", name: "entry", css: "who", by: (e) => e.name, cell: nameCell },
  { key: "kind", name: "kind", by: (e) => e.kind, cell: (e) => [e.kind] },
  { key: "class", name: "class", css: "number", by: (e) => e.class, cell: (e) => [String(e.class)] },
  { key: "success", name: "success", css: "number", by: (e) => e.success[0],
    cell: (e) => withSub(share(e.success[0]), `${share(e.success[1])} to ${share(e.success[2])}`) },
  { key: "score", name: "score", css: "number main", by: (e) => e.score[0],
    cell: (e) => withSub(amount(e.score[0]), finite(e.score[0]) ? range(e.score) : e.class ? "solves too few" : "fails too often") },
  { key: "acceleration", name: "peak acc.", unit: "straight line = 1", css: "number",
    by: (e) => e.acceleration, cell: (e) => [orDash(e.acceleration)] },
  { key: "bar", name: "95 % interval", css: "picture", cell: (e) => [scoreBar(e.score, shown.axis)] },
  ...["E_mean", "E_decay", "E_peak", "E_res"].map((key) => ({
    key, name: key, unit: "J", css: "number", by: (e) => e[key], cell: (e) => [orDash(e[key])],
  })),
  { key: "seconds", name: "time", unit: "s", css: "number", by: (e) => e.seconds, cell: (e) => [orDash(e.seconds)] },
  { key: "groups", name: "episodes", css: "number", by: (e) => e.groups,
    cell: (e) => [`${e.episodes}${e.groups > 1 ? ` × ${e.groups}` : ""}`] },
];

function nameCell(e) {
  const button = el("button", { type: "button", title: e.name, "aria-expanded": "false" }, e.name);
  button.addEventListener("click", () => {
    const open = button.getAttribute("aria-expanded") !== "true";
    go({ open: open ? e.file : "" }, drawTable);
  });
  return [button, el("span", { class: "sub", title: e.author }, e.author)];
}

const shown = { group: null, columns: [], axis: null, rows: new Map() };

/** Rows of a group are made once, and only put in order after that. */
function prepare(g) {
  if (shown.group === g) return;
  Object.assign(shown, { group: g, axis: barAxis(g), rows: new Map() });
  // energies of what moves nothing, times of what plans nothing: such columns are left out
  shown.columns = COLUMNS.filter(({ by }) => !by || g.entries.some((e) => by(e) !== undefined));
}

function rowOf(e) {
  if (!shown.rows.has(e)) {
    const line = el("tr", { class: e.rank[0] === 1 ? "entry best" : "entry" });
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
  const words = (e) => [e.name, e.author, e.kind].join(" ");
  const some = g.entries.filter((e) => terms.every((term) => words(e).includes(term)));
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
      button.addEventListener("click", () => go({ sort: state.sort === key ? `-${key}` : key }, drawTable));
      th.append(button);
    } else th.append(name);
    th.append(el("span", { class: "unit" }, (key === "bar" ? barUnit() : unit) ?? "\u00a0"));
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

function drawTable() {
  const g = group();
  drawOrder();
  const some = selected(g);
  const lines = [];
  for (const e of some) {
    const line = rowOf(e);
    const open = state.open === e.file;
    line.querySelector("th button").setAttribute("aria-expanded", open);
    lines.push(line);
    if (open) lines.push(detail(e));
  }
  if (!lines.length) lines.push(el("tr", {}, el("td", { colspan: shown.columns.length }, "No entry matches.")));
  const focused = document.activeElement;
  $("table").tBodies[0].replaceChildren(...lines);
  // a row that was moved has lost it
  if (focused !== document.activeElement && focused.isConnected) focused.focus({ preventScroll: true });
  $("count").textContent = `${some.length} of ${g.entries.length} entries`;
}

/** All that is known of an entry. */
function detail(e) {
  const json = (value) => (value && Object.keys(value).length ? el("pre", {}, JSON.stringify(value, null, 1)) : null);
  const facts = [
    ["score", `${amount(e.score[0])} (95 %: ${range(e.score)})`],
    ["by training seed", e.by_group.map(amount).join(", ")],
    ["failed", e.failed ? `${e.failed} of ${e.episodes * e.groups}` : "none"],
    ["code", codeOf(e.about.code)],
    ["repeat it", el("code", {}, e.repeat)],
    ["settings", json(e.settings)],
    ["told", json(e.about)],
  ].filter(([, value]) => value);
  return el("tr", { class: "detail" }, el("td", { colspan: shown.columns.length },
    el("dl", {}, ...facts.flatMap(([term, value]) => [el("dt", {}, term), el("dd", {}, value)]))));
}

/** A link where it is an address, else the module. */
function codeOf(place) {
  if (typeof place !== "string") return null;
  return place.startsWith("https://") ? el("a", { href: place, rel: "nofollow" }, place) : el("code", {}, place);
}

// ------------------------------------------------------------------------- bars

const BAR = { w: 150, h: 22, pad: 5 };

/** The axis all bars of a group share: from 0 if scores are above it and of one size. */
function barAxis({ entries, reference }) {
  const some = entries.filter((e) => finite(e.score[0]));
  const scores = some.map((e) => e.score[0]);
  const ends = some.flatMap((e) => e.score).filter(finite);
  if (ends.length === 0) return null;
  const sorted = [...scores].sort((a, b) => a - b);
  const [low, high] = [Math.min(...ends), Math.max(...ends)];
  const log = low > 0 && sorted.at(-1) / sorted[0] > 12;
  const margin = 0.04 * (high - low) || 0.04 * Math.abs(high) || 1;
  const from = log ? low / 1.15 : low < 0 ? low - margin : 0;
  const to = high + margin;
  const f = log ? Math.log : (k) => k;
  const at = (value) => BAR.pad + (BAR.w - 2 * BAR.pad) * (f(value) - f(from)) / (f(to) - f(from));
  return { at, from, to, log, bars: from === 0, mark: reference > from && reference < to ? reference : null };
}

/** The score as a dot, with a bar where there is a 0 to begin from; its interval as a whisker. */
function scoreBar([value, low, high], scale) {
  const picture = svg("svg", { class: "bar", viewBox: `0 0 ${BAR.w} ${BAR.h}`, "aria-hidden": "true" });
  if (scale === null || !finite(value)) {
    picture.append(svg("path", { class: "beyond", d: `M${BAR.w - 16} 6l5 5l-5 5m6 -10l5 5l-5 5` }));
    return picture;
  }
  const [x, middle, end] = [scale.at, BAR.h / 2, BAR.w - BAR.pad];
  if (scale.bars) {
    picture.append(svg("rect", { class: "amount", x: x(0), y: 6, width: x(value) - x(0), height: 10, rx: 1.5 }));
  }
  picture.append(svg("path", { class: "track", d: `M${BAR.pad} ${middle}H${end}` }));
  if (scale.mark !== null) {
    picture.append(svg("path", { class: "one", d: `M${x(scale.mark)} 2V${BAR.h - 2}` }));
  }
  const to = finite(high) ? x(high) : end;
  const from = finite(low) ? x(low) : x(value);
  picture.append(
    svg("path", { class: "whisker", d: `M${from} ${middle}H${to}M${from} 7V15${finite(high) ? `M${to} 7V15` : ""}` }),
    svg("circle", { class: "point", cx: x(value), cy: middle, r: 2.6 }),
  );
  if (!finite(high)) picture.append(svg("path", { class: "beyond", d: `M${BAR.w - 9} 7l5 4l-5 4` }));
  return picture;
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

const entriesOf = (t) => t.groups.reduce((n, g) => n + g.entries.length, 0);

function openTrack(t, focus = document.activeElement?.getAttribute("role") === "tab") {
  go({ track: t.track, problem: "", seeds: "", sort: "rank", open: "" }, () => {});
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

/** Who may be the best of a group: one name where that is settled. */
function candidates(g) {
  if (g.entries.length === 1) return "1 entry";
  const some = g.entries.filter((e) => e.rank[1] === 1 && finite(e.score[0])).map((e) => e.name);
  return some.length > 2 ? `${some[0]}, ${some.length - 1} others` : some.join(", ") || "nobody";
}

function drawProblems() {
  const groups = new Map(track().groups.map((g) => [g.problem, g]));
  $("problems").replaceChildren(...[...groups].map(([name, g]) => {
    const here = name === state.problem;
    const best = el("span", { class: "sub" }, candidates(here ? group() : g));
    const button = el("button", { type: "button", "aria-pressed": String(here) }, name.replace(/^ves\//, ""), best);
    button.addEventListener("click", () => {
      go({ problem: name, seeds: "", open: "" }, () => {});
      readState();
      drawAll();
      $("problems").querySelector("[aria-pressed=true]").focus();
    });
    return button;
  }));
  const here = $("problems").querySelector("[aria-pressed=true]");
  $("problems").scrollLeft = here.offsetLeft - $("problems").offsetLeft - 16;
}

function drawChoices() {
  const choices = track().groups.filter((k) => k.problem === state.problem).map((k) => k.seeds);
  $("seeds").replaceChildren(...choices.map((value) => el("option", { value }, value)));
  $("seeds").value = state.seeds;
  $("seeds").closest("label").hidden = choices.length < 2;
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
  $("score-name").textContent = `Score: ${scoreName(g)}, interquartile mean.${lead.class ? RULE : ""}`;
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
}

// --------------------------------------------------------------------------- start

function drawFrame() {
  const count = data.tracks.reduce((n, t) => n + entriesOf(t), data.shown.length);
  $("eyebrow").textContent = `Leaderboard of ves_gym · ${count} ${count === 1 ? "entry" : "entries"}`;
  $("nothing").hidden = data.tracks.length > 0;
  $("panel").hidden = $("tabs").hidden = data.tracks.length === 0;
  if (data.tracks.length === 0) $("verdict").textContent = "The board is empty.";
  $("shown-section").hidden = data.shown.length === 0;
  const head = el("tr", {}, ...["problem", "entry", "score", "success"].map((name) => el("th", { scope: "col" }, name)));
  const body = data.shown.map((e) => el("tr", {}, el("td", {}, ...withSub(e.problem, e.seeds)),
    el("th", { scope: "row", class: "who" }, ...withSub(e.name, e.author)),
    el("td", { class: "number" }, ...withSub(amount(e.score[0]), range(e.score))),
    el("td", { class: "number" }, share(e.success[0]))));
  $("shown").replaceChildren(el("thead", {}, head), el("tbody", {}, ...body));
}

$("filter").addEventListener("input", () => go({ filter: $("filter").value.trim() }, drawTable));
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
