(() => {
  const root = document.documentElement, button = document.querySelector(".theme");
  if (button) button.addEventListener("click", () => {
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
  });
  const search = document.querySelector("#search"), boxes = [...document.querySelectorAll(".filters input[type=checkbox]")];
  const rows = [...document.querySelectorAll("[data-search]")], none = document.querySelector("#none");
  const apply = () => {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const on = new Set(boxes.filter(b => b.checked).map(b => b.value));
    let shown = 0;
    for (const row of rows) {
      const fits = on.has(row.dataset.verdict) && words.every(w => row.dataset.search.includes(w));
      row.hidden = !fits; shown += fits;
    }
    none.hidden = shown > 0;
  };
  if (search) { search.addEventListener("input", apply); boxes.forEach(b => b.addEventListener("change", apply)); }
  // What is marked should be seen, also where the list of fields is longer than its box.
  const reveal = tree => {
    const bad = tree.querySelector(".bad");
    if (bad && tree.clientHeight) tree.scrollTop = bad.offsetTop - tree.offsetTop - tree.clientHeight / 2;
  };
  for (const card of document.querySelectorAll("details.card")) {
    const all = () => card.querySelectorAll(".tree").forEach(reveal);
    card.addEventListener("toggle", all);
    if (card.open) all();
  }
  const open = () => {
    const target = location.hash && document.getElementById(location.hash.slice(1));
    if (target && target.tagName === "DETAILS") { target.hidden = false; target.open = true; target.scrollIntoView(); }
  };
  addEventListener("hashchange", open); open();
})();
