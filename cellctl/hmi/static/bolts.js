// The bolt map: a shape for each verdict, so that it can be read without colour.
const SVG = "http://www.w3.org/2000/svg";

function put(parent, name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  parent.append(element);
  return element;
}

// The newest result of each bolt, and the stage that counts as the last one seen.
function newest(items) {
  const found = new Map();
  for (const item of items) {
    const before = found.get(item.index);
    // A verdict that is not OK stays seen until the same stage is OK.
    if (!before || before.verdict === "ok" || before.stage === item.stage) found.set(item.index, item);
  }
  return found;
}

export function drawBolts(svg, joints, finished) {
  svg.replaceChildren();
  const count = joints.count || 0;
  const results = newest(joints.items);
  const stages = [...new Set(joints.items.map((item) => item.stage))];
  const last = stages[stages.length - 1];
  const tally = { ok: 0, part: 0, bad: 0 };
  put(svg, "circle", { r: 95, class: "bolt" });
  for (let index = 0; index < count; index += 1) {
    const angle = (2 * Math.PI * index) / count;
    const [x, y] = [120 * Math.cos(angle), -120 * Math.sin(angle)];
    const result = results.get(index);
    const size = Math.min(8, 300 / count);
    let kind = "";
    if (result) kind = result.verdict !== "ok" ? "bad" : finished || result.stage === last ? "ok" : "part";
    if (kind) tally[kind] += 1;
    const dot = put(svg, "circle", { cx: x, cy: y, r: size, class: `bolt ${kind === "bad" ? "" : kind}` });
    const said = result ? `${result.stage}: ${result.torque_nm.toFixed(1)} N m, ${result.angle_deg.toFixed(0)}\u00b0, ${result.verdict}` : "open";
    put(dot, "title", {}, `bolt ${index}, ${said}`);
    if (kind === "bad") put(svg, "text", { x, y, class: "mark" }, result.verdict === "nok" ? "\u2715" : "?");
    put(svg, "text", { x: x * 0.87, y: y * 0.87, class: "number" }, String(index));
  }
  const stage = last ? `stage ${last}: ` : "";
  return count ? `${stage}${tally.ok} of ${count} bolts OK, ${tally.part} in an earlier stage, ${tally.bad} not OK` : "no joint yet";
}
