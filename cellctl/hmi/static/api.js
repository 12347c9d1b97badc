// The REST API and its event stream. The token stays in this browser tab.
const BASE = "/api/v1";

export class SignedOut extends Error {}

export class Api {
  constructor(token) { this.token = token; }

  async ask(path, options = {}) {
    const headers = { Authorization: `Bearer ${this.token}`, ...options.headers };
    const answer = await fetch(BASE + path, { ...options, headers, cache: "no-store" });
    if (answer.status === 401) throw new SignedOut("the token is not known");
    return answer;
  }

  async get(path) {
    const answer = await this.ask(path);
    if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
    return answer.json();
  }

  // Gives the sentence of a refusal, or "" where the command was taken.
  async command(command) {
    const body = JSON.stringify({ command });
    const answer = await this.ask("/cell/commands", { method: "POST", body, headers: { "Content-Type": "application/json" } });
    if (answer.ok) return "";
    const problem = await answer.json();
    const allowed = (problem.allowed_commands || []).join(", ");
    return allowed ? `${problem.detail}. Allowed: ${allowed}` : problem.detail;
  }

  // Every event after the one with the id `after`, in order; ends with the connection.
  async *events(after, signal) {
    const answer = await this.ask("/events", { headers: { "Last-Event-ID": after }, signal });
    if (!answer.ok) throw new Error(`events: ${answer.status}`);
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let buffer = "";
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      buffer = (buffer + value).replaceAll("\r\n", "\n");
      const blocks = buffer.split("\n\n");
      buffer = blocks.pop();
      for (const block of blocks) {
        const lines = block.split("\n").filter((line) => line.startsWith("data:"));
        yield lines.length ? JSON.parse(lines.map((line) => line.slice(5)).join("\n")) : null;
      }
    }
  }
}
