(() => {
  const root = document.documentElement, scheme = matchMedia("(prefers-color-scheme: dark)");
  const dark = () => (root.dataset.theme ? root.dataset.theme === "dark" : scheme.matches);
  const json = (id) => JSON.parse(document.getElementById(id)?.textContent ?? "[]");
  const items = json("plots"), colours = json("swap"), views = new Map(), spans = new Map();

  // Every colour of a plot is one of the light scheme or of the dark one.
  function exchange() {
    const to = dark() ? 1 : 0;
    return new Map(colours.map((pair) => [pair[1 - to], pair[to]]));
  }

  function paint(model) {
    const now = exchange();
    for (const each of model.references()) {
      const changed = {};
      for (const name of Object.keys(each.properties)) {
        const property = each.properties[name];
        if (property.is_unset || !/color/.test(name)) continue;
        const value = property.get_value();
        if (now.has(value)) changed[name] = now.get(value);
        else if (value && now.has(value.value)) changed[name] = { value: now.get(value.value) };
      }
      each.setv(changed);
    }
  }

  // Plots over time zoom together.
  function link(model, group) {
    const span = spans.get(group);
    if (span) model.x_range.setv(span);
    model.x_range.change.connect(() => {
      const { start, end } = model.x_range, known = spans.get(group);
      if (known && known.start === start && known.end === end) return;
      spans.set(group, { start, end });
      for (const [name, other] of views) {
        if (items[name].time && items[name].group === group) other.x_range.setv({ start, end });
      }
    });
  }

  async function show(place) {
    const name = place.dataset.plot;
    if (views.has(name)) return;
    views.set(name, null);
    // In its colours from the start: what is painted over shines through at the edges.
    const now = exchange(), item = JSON.parse(JSON.stringify(items[name].item), (_, value) => now.get(value) ?? value);
    const manager = await Bokeh.embed.embed_item(item, place.id);
    const model = [...manager][0].model;
    views.set(name, model);
    // The legend has as many columns as fit; without this, as many as fit on a small screen.
    const legend = model.below.find((each) => each.type === "Legend");
    if (legend) {
      const longest = Math.max(...legend.items.map(({ label }) => (label?.value ?? label ?? "").length));
      const columns = Math.max(legend.ncols, Math.min(6, Math.floor((place.clientWidth - 120) / (48 + 7 * longest))));
      const rows = (many) => Math.ceil(legend.items.length / many);
      model.height -= 22 * (rows(legend.ncols) - rows(columns));
      legend.ncols = columns;
      place.style.minHeight = model.height + "px";
    }
    // A finger scrolls the page until a tool is chosen.
    if (matchMedia("(pointer: coarse)").matches) for (const tool of model.toolbar.tools) if (tool.active && tool.type !== "HoverTool") tool.active = false;
    if (items[name].time) link(model, items[name].group);
    place.dataset.shown = "";
  }

  const places = [...document.querySelectorAll("[data-plot]")];
  const near = new IntersectionObserver(
    (entries) => entries.filter((each) => each.isIntersecting).forEach((each) => { near.unobserve(each.target); show(each.target); }),
    { rootMargin: "600px" },
  );
  places.forEach((each) => near.observe(each));
  addEventListener("beforeprint", () => places.forEach(show));

  const repaint = () => views.forEach((model) => model && paint(model));
  scheme.addEventListener("change", repaint);
  document.querySelector(".theme").addEventListener("click", repaint);
})();
