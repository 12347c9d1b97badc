// The bolt map: a shape for each state, so that it can be read without colour. What is proven for a bolt, the service says.
const SVG = "http://www.w3.org/2000/svg";
const SHAPE = { open: "", partial: "part", ok: "ok", nok: "bad", unknown: "bad" };

function put(parent, name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  parent.append(element);
  return element;
}

function number(value, digits) {
  return value === null ? "?" : value.toFixed(digits);
}

function said(result) {
  return `${result.stage} ${number(result.torque_nm, 1)} N m, ${number(result.angle_deg, 0)}\u00b0, ${result.verdict}`;
}

export function drawBolts(svg, joints) {
  svg.replaceChildren();
  const count = joints.bolts.length;
  if (!count) return "no joint yet";
  const tally = { open: 0, partial: 0, ok: 0, nok: 0, unknown: 0 };
  const size = Math.min(8, 300 / count);
  put(svg, "circle", { r: 95, class: "bolt" });
  for (const { index, angle_deg: nominal, state } of joints.bolts) {
    const angle = (nominal * Math.PI) / 180;
    const [x, y] = [120 * Math.cos(angle), -120 * Math.sin(angle)];
    const shape = SHAPE[state];
    tally[state] += 1;
    const dot = put(svg, "circle", { cx: x, cy: y, r: size, class: `bolt ${shape}` });
    const results = joints.items.filter((item) => item.index === index).map(said);
    put(dot, "title", {}, `bolt ${index}, ${state}: ${results.join("; ") || "no result"}`);
    if (shape === "bad") put(svg, "text", { x, y, class: "mark" }, state === "nok" ? "\u2715" : "?");
    put(svg, "text", { x: x * 0.87, y: y * 0.87, class: "number" }, String(index));
  }
  const bad = tally.nok + tally.unknown;
  const last = joints.items.length ? `last result in stage ${joints.items[joints.items.length - 1].stage}: ` : "";
  return `${last}${tally.ok} of ${count} bolts OK in every stage, ${tally.partial} in some, ${bad} not OK`;
}
