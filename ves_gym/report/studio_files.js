// Files that are opened in the studio: motions and plans are played here, run logs and episodes
// come converted by `ves-gym studio --open`, a diagnosis is shown and its machine can be driven.

const PALETTE = [[2, ""], [4, ""], [5, ""], [6, ""], [3, ""]];
const opened = []; // { name, track } of logs, { name, motion } of motions

const machineOf = (track) => track.machine ?? data.machine;

/** The description of the machine in a case's text. */
const machineText = (text) => /^\[system[^]*?(?=^\[(?!\[?system))/m.exec(`${text}\n[`)?.[0].trim();

/** What a case holds, as `Case.save` writes it in TOML: its motion, on this page's machine. */
function readCase(name, text) {
  if (machineText(text) !== machineText(data.case)) {
    throw new Error(`${name} is of another machine than this page: ves-gym studio --case ${name}`);
  }
  const body = text.split(/^\[motion\]$/m)[1]?.split(/^\[/m)[0];
  if (!body) throw new Error(`${name}: the case has no motion`);
  const entry = (key) => new RegExp(`^${key} = (\\[[^]*\\]|\\S+)`, "m").exec(body)[1];
  const [duration, control] = ["duration", "control"].map((key) => JSON.parse(entry(key).replace(/,(\s*\])/g, "$1")));
  return [{ kind: "motion", name: name.replace(/\.toml$/i, ""), motion: { duration, control } }];
}

/** What a file holds: items of kind motion, log or diagnosis. */
function readItems(name, text) {
  if (/^\[system/m.test(text)) return readCase(name, text);
  let table;
  try {
    table = JSON.parse(text) ?? {};
  } catch {
    table = {};
  }
  switch (table.schema) {
    case "ves-diagnose/1":
      return [{ kind: "diagnosis", name: name.replace(/\.json$/i, ""), diagnosis: table }];
    case "ves-studio/1":
      return table.opened;
    default:
      throw new Error(`${name}: expected a case (.toml), a diagnosis or what \`ves-gym studio --json\` `
        + `writes, got ${table.schema ?? "none of these"}. Run logs and episodes (.parquet, .csv) are `
        + "opened by ves-gym studio --open FILE.");
  }
}

/** Take an item in; what it can be shown as, or null. */
function takeItem(item) {
  if (item.kind === "diagnosis") {
    showDiagnosis(item);
    if (!item.machine) return null;
    const name = `drawn path, ${item.name}`;
    const same = item.machine.base.M.length === data.machine.base.M.length;
    // its base is matrices: drawn as the described one, whose coordinates it moves in
    const beam = item.machine.beam ?? (same ? data.machine.beam : null);
    return enter({ name, machine: { ...item.machine, beam }, live: true });
  }
  const machine = item.machine ?? data.machine;
  const n = machine.arm.links.length;
  if (item.kind === "log") return enter({ name: item.name, track: { ...item.track, name: item.name, machine } });
  const { control, duration } = item.motion;
  if (!Array.isArray(control) || !control.every((row) => Array.isArray(row) && row.length === n
    && row.every(Number.isFinite)) || control.length < DEGREE + 1 || !(duration > 0)) {
    throw new Error(`${item.name}: expected control points of ${n} joints and a duration > 0 s`);
  }
  return enter({ name: item.name, motion: { control, duration }, machine: item.machine });
}

function enter(entry) {
  const same = opened.findIndex((one) => one.name === entry.name);
  const at = same >= 0 ? same : opened.length;
  opened[at] = entry;
  STYLES[entry.name] ??= PALETTE[at % PALETTE.length]; // a planner has its own
  return entry;
}

function showDiagnosis({ name, diagnosis }) {
  const text = (value) => (Array.isArray(value) ? value.map((v) => number(v)).join(", ") : number(value));
  const rows = (diagnosis.effects ?? []).flatMap((effect) => Object.entries(effect.value).map(([key, value]) => {
    const ends = effect.interval?.[key];
    const unit = effect.unit?.[key] ?? "1";
    return el("tr", {}, el("td", {}, effect.name), el("td", {}, key),
      el("td", { class: "number" }, text(value)),
      el("td", { class: "number" }, ends ? `${text(ends[0])} – ${text(ends[1])}` : "–"),
      el("td", {}, unit === "1" ? "" : unit),
      el("td", { class: "number" }, number(effect.probability, 2)));
  }));
  const head = ["effect", "parameter", "estimate", "90 % interval", "unit", "probability"];
  $("diagnoses").append(el("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": `Diagnosis ${name}` },
    el("table", {}, el("caption", {}, `${name}: ${diagnosis.sentence ?? diagnosis.verdict}`),
      el("thead", {}, el("tr", {}, ...head.map((word, k) => el("th", { scope: "col", class: [2, 3, 5].includes(k) ? "number" : null }, word)))),
      el("tbody", {}, ...rows))));
}

// ----------------------------------------------------------------------- in the page

function sayOfFiles(text, bad = false) {
  $("files-note").textContent = text;
  $("files-note").classList.toggle("bad", bad);
}

/** Open files that were chosen; the first that can be shown is put beside the drawn path. */
async function openFiles(files) {
  const names_ = [];
  let first = null;
  for (const file of files) {
    try {
      for (const item of readItems(file.name, await file.text())) {
        const entry = takeItem(item);
        first ??= entry;
      }
      names_.push(file.name);
    } catch (error) {
      sayOfFiles(error.message, true);
      return;
    }
  }
  sayOfFiles(names_.length ? `Opened: ${names_.join(", ")}.` : "");
  fillChoices();
  if (first) choose(0, first.name);
}

/** The drawn path as a case that `ves-gym simulate --case` plays: the same machine, the same energy. */
function caseOfDrawn() {
  const { duration, control } = path.motions[DRAWN];
  const rows = control.map((row) => `    [${row.map(float).join(", ")}],\n`).join("");
  return `${data.case}\n[motion]\nduration = ${float(duration)}\ncontrol = [\n${rows}]\n`;
}

function saveDrawn() {
  download(caseOfDrawn(), "application/toml", "case.toml");
}

/** A number as TOML writes one that need not be whole. */
const float = (value) => (Number.isInteger(value) ? `${value}.0` : `${value}`);
