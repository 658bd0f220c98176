// What a page looks like and where its focus is, for looks.py.
({
  name: (each) => each.outerHTML.slice(0, 140),
  isSeen(each) {
    if (!each.checkVisibility({ visibilityProperty: true }) || each.closest(".skip")) return false;
    for (let at = each; at; at = at.parentElement)
      if (getComputedStyle(at).clipPath !== "none") return false; // for screen readers only
    return true;
  },

  /** What is cut, and pictures without a text. */
  cut() {
    const found = [];
    const wide = document.documentElement.scrollWidth;
    if (wide > innerWidth) found.push(`wider than the screen: ${wide}`);
    for (const each of document.querySelectorAll("canvas, svg, img, video")) {
      const named = each.closest("[aria-label], [aria-labelledby], [aria-hidden=true]");
      if (this.isSeen(each) && !named && !each.getAttribute("alt"))
        found.push(`without a text: ${this.name(each)}`);
    }
    for (const each of document.querySelectorAll("[aria-current], [aria-selected=true]")) {
      const { left, right } = each.getBoundingClientRect();
      if (this.isSeen(each) && (left < 0 || right > innerWidth))
        found.push(`chosen and out of view: ${this.name(each)}`);
    }
    for (const each of document.querySelectorAll("header *, main *, dialog *")) {
      const hides = /hidden|clip/.test(getComputedStyle(each).overflowX);
      const isCut = each.scrollWidth > each.clientWidth + 1 && each.textContent.trim();
      if (hides && isCut && this.isSeen(each)) found.push(`cut: ${this.name(each)}`);
    }
    return found;
  },

  /** Marks all controls by their number; of radio buttons only one is reached by Tab. */
  controls() {
    const kinds = "a[href], button, input, select, textarea, summary, [tabindex='0']";
    const open = document.querySelector("dialog[open]") ?? document;
    const all = [...open.querySelectorAll(kinds)].filter(
      (each) => !each.disabled && each.tabIndex >= 0 && this.isSeen(each),
    );
    const groups = new Map();
    return all
      .filter((each) => {
        const key = each.type === "radio" ? each.name : each;
        const isNew = !groups.has(key);
        if (isNew) groups.set(key, groups.size);
        each.dataset.tried = groups.get(key);
        return isNew;
      })
      .map(this.name);
  },

  /** The element that has the focus, and whether people see that it has it. */
  focused() {
    const each = document.activeElement;
    if (each === document.body) return null;
    const style = getComputedStyle(each);
    const { left, right, top, bottom } = each.getBoundingClientRect();
    const middle = (low, high, most) =>
      Math.min(Math.max((Math.max(low, 0) + Math.min(high, most)) / 2, 1), most - 1);
    const above = document.elementFromPoint(
      middle(left, right, innerWidth),
      middle(top, bottom, innerHeight),
    );
    const own = [each, ...(each.labels ?? [])];
    return {
      key: each.dataset.tried ?? null,
      name: this.name(each),
      isMarked: style.outlineStyle !== "none" && parseFloat(style.outlineWidth) > 0,
      isInView: bottom > 0 && top < innerHeight && right > 0 && left < innerWidth,
      isCovered: !own.some((part) => part.contains(above) || above?.contains(part)),
      takesTab: each.tagName === "TEXTAREA",
    };
  },
});
