// Requests to the console's own server.

/** An error of the server: one sentence, and what to do. */
export class ApiError extends Error {
  constructor(status, { message, remedy = "", code = 0, ...more }) {
    super(message);
    Object.assign(this, { status, remedy, code, ...more });
  }
}

const refused = (status, answer) =>
  Object.assign(
    new ApiError(status, answer?.error ?? { message: `The console answered ${status}.` }),
    { answer },
  );

/** The answer to a request, whose error is thrown. */
async function answerOf(method, path, body, signal) {
  const isFile = body instanceof Blob || body instanceof FormData;
  const headers = body === undefined || isFile ? {} : { "content-type": "application/json" };
  const sent = isFile ? body : JSON.stringify(body);
  const answer = await fetch(path, { method, signal, headers, body: sent }).catch((error) => {
    if (error.name === "AbortError") throw error;
    throw new ApiError(0, {
      message: "The console does not answer.",
      remedy: "Start it with `dr console start`; the page connects again by itself.",
    });
  });
  if (!answer.ok) throw refused(answer.status, await answer.json().catch(() => null));
  return answer;
}

/** What is answered as JSON; an answer of something between is none. */
async function request(method, path, body, signal) {
  const answer = await answerOf(method, path, body, signal);
  return answer.json().catch((error) => {
    throw error.name === "AbortError" ? error : refused(answer.status, null);
  });
}

export const get = (path, signal) => request("GET", path, undefined, signal);
export const post = (path, body = {}, signal) => request("POST", path, body, signal);
export const put = (path, body = {}, signal) => request("PUT", path, body, signal);
export const remove = (path, signal) => request("DELETE", path, undefined, signal);

/** The answer to a request for what is not JSON; its error may be. */
const file = (path, signal) => answerOf("GET", path, undefined, signal);

export const getBlob = async (path, signal) => (await file(path, signal)).blob();

/** Facts and pictures (blobs) of a packed answer: four bytes with the length of the facts, the facts, the pictures. */
export async function getPacked(path, signal, type = "image/jpeg") {
  const buffer = await (await file(path, signal)).arrayBuffer();
  const end = 4 + new DataView(buffer).getUint32(0);
  const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, end - 4)));
  let at = end;
  const pictures = facts.lengths.map(
    (length) => new Blob([new Uint8Array(buffer, (at += length) - length, length)], { type }),
  );
  return { facts, pictures };
}

/** A path below /api from its parts; each is escaped, so a model may have any name. */
export const api = (...parts) => "/api/" + parts.map((part) => encodeURIComponent(part)).join("/");
