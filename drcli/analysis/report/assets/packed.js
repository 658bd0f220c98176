// Numbers as Python packed them: see `numbers` and `quantised` of markup.py.

const KINDS = { f32: Float32Array, i16: Int16Array, i8: Int8Array };

/** A list, or integers in steps around a middle, or floats; missing numbers are NaN. */
export function unpacked(packed) {
  if (Array.isArray(packed)) return Float64Array.from(packed, (value) => value ?? NaN);
  const kind = Object.keys(KINDS).find((name) => name in packed);
  const bytes = Uint8Array.from(atob(packed[kind]), (letter) => letter.charCodeAt(0));
  const values = new KINDS[kind](bytes.buffer);
  if (kind === "f32") return values;
  const missing = -(2 ** (8 * values.BYTES_PER_ELEMENT - 1));
  return Float32Array.from(values, (value) =>
    value === missing ? NaN : packed.middle + value * packed.step,
  );
}

/** An object of packed columns, unpacked. @returns {Record<string, any>} */
export const columns = (packed) =>
  Object.fromEntries(Object.entries(packed).map(([name, values]) => [name, unpacked(values)]));
