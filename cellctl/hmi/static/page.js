// The operator's page: asks for the truth, then follows the events; after any break it asks for the truth again.
import { Api, SignedOut } from "/page/api.js";
import { drawBolts } from "/page/bolts.js";

const PHASES = [["scan", "Scan"], ["align", "Align"], ["jack_up", "Jack up"], ["heat", "Heat"], ["tighten", "Tighten"]];
const LABELS = { reset: "Reset", hold: "Hold", unhold: "Unhold", suspend: "Suspend", unsuspend: "Unsuspend", clear: "Clear", complete: "Complete early" };
const ABNORMAL = new Set(["Aborting", "Aborted", "Clearing"]);
const ATTENTION = new Set(["Holding", "Held", "Suspending", "Suspended", "Stopping"]);
const NEXT = { Starting: "the order is tried on a private twin, then the cell begins", Resetting: "re-arming: every set-point becomes what is measured", Idle: "ready for a job order", Complete: "waits for reset before the next order", Stopped: "reset makes it ready", Aborted: "look at the cell, then clear" };
const STALE_MS = 20000;
const BOLTS_MS = 1500;
const NOT_ENDED = { verdict: null, reasons: [], sealed: false };
const by = (id) => document.getElementById(id);
const wait = (ms) => new Promise((done) => setTimeout(done, ms));

let api = null;
let heard = 0;
let shownRun = "";
let shownAt = 0;

function token() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token");
}

function listed(text, kind) {
  const item = document.createElement("li");
  item.className = kind;
  item.textContent = text;
  return item;
}

function showCell(cell) {
  by("cell-name").textContent = cell.name;
  by("simulated").hidden = !cell.simulated;
  const state = by("state");
  state.textContent = cell.state;
  state.className = ABNORMAL.has(cell.state) ? "abnormal" : ATTENTION.has(cell.state) ? "attention" : "";
  by("why").textContent = cell.why;
  by("order").textContent = cell.run_id ? `order ${cell.job_order_id}, run ${cell.run_id}` : "no order";
  showProgress(cell);
  showCommands(cell.allowed_commands);
  by("alarms").replaceChildren(...cell.alarms.map((alarm) => {
    const text = `${alarm.text} (${alarm.code}${alarm.latched ? ", latched" : ""})`;
    return listed(text, alarm.latched ? "latched" : "");
  }));
  by("unsafe").replaceChildren(...cell.unsafe_devices.map(({ device, reason }) => listed(`${device} is not proven safe: ${reason}`, "bad")));
}

function showProgress(cell) {
  const at = PHASES.findIndex(([name]) => name === cell.phase);
  const over = cell.state === "Complete";
  by("phases").replaceChildren(...PHASES.map(([, label], index) => {
    const item = document.createElement("li");
    item.textContent = label;
    if (over || index < at) item.dataset.state = "done";
    if (!over && index === at) item.setAttribute("aria-current", "step");
    return item;
  }));
  const percent = Math.floor(100 * cell.progress.fraction);
  by("progress").value = cell.progress.fraction;
  by("percent").textContent = `${percent} %`;
  by("text").textContent = cell.state === "Execute" ? cell.progress.text : NEXT[cell.state] || cell.progress.text;
  const left = cell.progress.time_left_s;
  by("left").textContent = left === null ? "" : `about ${Math.ceil(left / 60)} min of cell time left`;
}

function showCommands(allowed) {
  const wanted = allowed.filter((command) => command in LABELS);
  const shown = [...by("commands").children].map((button) => button.dataset.command);
  if (shown.join() === wanted.join()) return;
  by("commands").replaceChildren(...wanted.map((command) => {
    const button = document.createElement("button");
    button.type = "button";
    button.dataset.command = command;
    button.textContent = LABELS[command];
    return button;
  }));
}

async function showRun(cell) {
  if (!cell.run_id) {
    by("result").hidden = true;
    by("bolts-summary").textContent = drawBolts(by("bolts"), { items: [], bolts: [] });
    return;
  }
  shownRun = cell.run_id;
  shownAt = Date.now();
  const run = cell.state === "Execute" ? NOT_ENDED : await api.get(`/runs/${cell.run_id}`);
  const joints = await api.get(`/runs/${cell.run_id}/joints`);
  by("bolts-summary").textContent = drawBolts(by("bolts"), joints);
  by("result").hidden = !run.verdict;
  by("verdict").textContent = run.verdict ? `${run.verdict}${run.sealed ? ", sealed" : ""}` : "";
  by("verdict").className = run.verdict === "accepted" ? "" : "abnormal";
  by("reasons").replaceChildren(...run.reasons.map((reason) => listed(reason, "")));
  if (run.verdict) showScans((await api.get(`/runs/${cell.run_id}/scans`)).items.filter((scan) => scan.measured));
}

function showScans(measured) {
  const kept = measured.some((scan) => scan.kept);
  by("scans").hidden = !kept;
  by("scans-told").textContent = kept || !measured.length ? "" : "its scans are not kept";
}

async function truth() {
  const cell = await api.get("/cell");
  showCell(cell);
  return cell;
}

function linked(text, stale) {
  by("link").textContent = text;
  document.body.classList.toggle("stale", stale);
}

// Events say that something is new; what it is, is asked for, at most a few times a second.
async function follow() {
  const cell = await truth();
  await showRun(cell);
  const ended = new AbortController();
  let fresh = false;
  const look = (async () => {
    while (!ended.signal.aborted) {
      await wait(300);
      if (Date.now() - heard > STALE_MS) ended.abort();
      if (!fresh) continue;
      fresh = false;
      const now = await truth();
      if (Date.now() - shownAt > BOLTS_MS || now.state !== "Execute") await showRun(now);
    }
  })();
  const listen = (async () => {
    heard = Date.now();
    linked("live", false);
    for await (const event of api.events(cell.event_id, ended.signal)) {
      heard = Date.now();
      fresh = fresh || event !== null;
    }
  })();
  try {
    await Promise.race([look, listen]);
  } finally {
    ended.abort();
    await Promise.allSettled([look, listen]);
  }
}

async function main() {
  for (;;) {
    try {
      by("login").hidden = true;
      by("main").hidden = false;
      await follow();
    } catch (error) {
      if (error instanceof SignedOut) return signIn(error.message);
    }
    linked("connection lost: what is shown is old", true);
    await wait(1000);
  }
}

function signIn(message) {
  by("main").hidden = true;
  by("login").hidden = false;
  by("login-error").textContent = message || "";
  linked("not signed in", false);
}

function begin() {
  const known = token();
  if (!known) return signIn("");
  api = new Api(known);
  return main();
}

by("login").addEventListener("submit", (event) => {
  event.preventDefault();
  sessionStorage.setItem("token", by("token").value.trim());
  begin();
});

document.addEventListener("click", async (event) => {
  const button = event.target.closest("button[data-command]");
  if (!button || !api) return;
  try {
    by("refused").textContent = await api.command(button.dataset.command);
  } catch (error) {
    by("refused").textContent = `not sent: ${error.message}`;
  }
});

async function open(kind, name) {
  const answer = await api.ask(`/runs/${shownRun}/${kind}`);
  by("refused").textContent = "";
  if (!answer.ok) {
    by("refused").textContent = (await answer.json()).detail;
    return;
  }
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await answer.blob());
  link.download = `${shownRun}${name}`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

by("report").addEventListener("click", () => open("report", ".html"));
by("record").addEventListener("click", () => open("record", ".zip"));
by("scans").addEventListener("click", async () => {
  by("scans").disabled = true;
  by("scans-told").textContent = "the page is being made";
  await open("scans/page", "-scans.html").catch((error) => { by("refused").textContent = `no page: ${error.message}`; });
  by("scans").disabled = false;
  by("scans-told").textContent = "";
});

begin();
