// Ask the server that gave this page.

export async function get(path) {
  return answer(await fetch(path));
}

export async function post(path, data) {
  return answer(
    await fetch(path, {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(data)}));
}

async function answer(response) {
  const data = await response.json();
  if (!response.ok) throw new Error(data.error || response.statusText);
  return data;
}

// Codes of one picture tile, and whether it is complete.
export async function getTile(kind, level, row, column) {
  const response = await fetch(`api/${kind}/${level}/${row}/${column}`);
  if (!response.ok) throw new Error(response.statusText);
  return {codes: new Uint8Array(await response.arrayBuffer()), final: response.headers.get("X-Final") === "1"};
}
