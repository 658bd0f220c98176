// Elements of SVG.

const NAMESPACE = ["http:", "", "www.w3.org", "2000", "svg"].join("/"); // a name, which nobody loads

/** An SVG element; null and undefined attributes are left out. */
export function svg(tag, attributes, ...children) {
  const element = document.createElementNS(NAMESPACE, tag);
  for (const [name, value] of Object.entries(attributes))
    if (value !== null && value !== undefined) element.setAttribute(name, value);
  element.append(...children);
  return element;
}
