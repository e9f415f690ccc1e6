(() => {
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
  // Scroll a list of fields that is longer than its box to the first marked field.
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
    if (!target) return;
    // The target of a link may be inside closed elements: open all of them.
    for (let each = target.closest("details"); each; each = each.parentElement.closest("details")) { each.hidden = false; each.open = true; }
    target.scrollIntoView();
  };
  addEventListener("hashchange", open); open();
  // The table "Values held by each node" at the time of the slider.
  const source = document.querySelector("#holds-data");
  if (source) {
    const data = JSON.parse(source.textContent), table = document.querySelector("#holds");
    const at = document.querySelector("#holds-at"), when = document.querySelector("#holds-when");
    const DELETED = -1, ASKED = -2, nodes = data.nodes, variables = data.variables;
    const order = variables.map((_, i) => i).sort((a, b) => variables[a] - variables[b]);
    const columns = nodes.map((_, i) => i).sort((a, b) => nodes[a] < nodes[b] ? -1 : 1);
    // Times of changes in intervals of data.interval_ns; each is a position of the slider.
    const times = []; let clock = 0;
    for (const change of data.changes) { clock += change[0]; if (times[times.length - 1] !== clock) times.push(clock); }
    const end = Math.floor((data.end_ns - data.begin_ns) / data.interval_ns);
    if (end > times[times.length - 1]) times.push(end);
    const seconds = t => (t * data.interval_ns / 1e9).toFixed(data.interval_ns < 1e7 ? 3 : 1);
    const replay = visit => {
      const held = new Map(), producer = new Map(), since = new Map(), bad = new Set();
      let p = 0, c = 0, now = 0, i = 0;
      const judge = v => {
        const mine = producer.get(v), right = mine === undefined ? undefined : held.get(v * nodes.length + mine);
        for (const n of columns) {
          const key = v * nodes.length + n, has = held.get(key);
          const wrong = right !== undefined && has !== undefined && has !== right;
          if (wrong && !bad.has(key)) { bad.add(key); since.set(key, now); }
          if (!wrong) bad.delete(key);
        }
      };
      for (const t of times) {
        now = t;
        const touched = new Set();
        while (p < data.producers.length && data.producers[p][0] <= t) { producer.set(data.producers[p][1], data.producers[p][2]); touched.add(data.producers[p++][1]); }
        for (; i < data.changes.length; i++) {
          const [step, n, v, number] = data.changes[i];
          if (c + step > t) break;
          c += step; held.set(v * nodes.length + n, number); touched.add(v);
        }
        touched.forEach(judge);
        if (visit(t, held, producer, bad, since) === false) return;
      }
    };
    const cells = new Map(), head = table.createTHead().insertRow(), body = table.createTBody();
    const heading = (row, text, scope, title) => { const th = document.createElement("th"); th.scope = scope; th.textContent = text; th.title = title; row.append(th); };
    heading(head, "variable", "col", "");
    for (const n of columns) heading(head, nodes[n].slice(-5), "col", nodes[n]);
    for (const v of order) {
      const row = body.insertRow(); heading(row, variables[v], "row", "variable " + variables[v]);
      for (const n of columns) cells.set(v * nodes.length + n, row.insertCell());
    }
    const differs = []; let place = 0;
    replay((t, held, producer, bad) => { differs[place++] = bad.size > 0; });
    const draw = () => {
      const goal = times[at.value];
      replay((t, held, producer, bad, since) => {
        if (t < goal) return true;
        for (const [key, cell] of cells) {
          const number = held.get(key), wrong = bad.has(key), own = producer.get(Math.floor(key / nodes.length)) === key % nodes.length;
          const text = number === undefined ? "" : number === DELETED ? "\u00d7" : number === ASKED ? "?" : String(number);
          cell.textContent = wrong ? "\u2260 " + text : text;
          cell.className = wrong ? "bad" : own ? "own" : "";
          cell.title = wrong ? "differs for " + seconds(t - since.get(key)) + " s" : "";
        }
        const long = [...bad].reduce((most, key) => Math.max(most, t - since.get(key)), 0);
        when.textContent = "+" + seconds(t) + " s: " + (bad.size ? bad.size + (bad.size === 1 ? " number differs" : " numbers differ") + " from the producer's, the longest for " + seconds(long) + " s" : "all numbers equal the producers'");
        return false;
      });
    };
    const jump = step => () => {
      let i = Number(at.value) + step;
      while (i > 0 && i < times.length - 1 && !differs[i]) i += step;
      at.value = Math.min(Math.max(i, 0), times.length - 1); draw();
    };
    // A click on a cell tells how its value came there; a row of changes names the row that it came from.
    const rows = []; let passed = 0;
    for (const [step, n, v, number, frame, asked, source, by] of data.changes) { passed += step; rows.push({ t: passed, n, v, number, frame, asked, source, by }); }
    const why = document.querySelector("#holds-why");
    const tell = key => {
      const v = Math.floor(key / nodes.length), n = key % nodes.length, goal = times[at.value];
      let place = rows.findLastIndex(row => row.t <= goal && row.v === v && row.n === n);
      why.replaceChildren();
      const line = text => { const li = document.createElement("li"); li.textContent = text; why.append(li); };
      if (place < 0) { line(nodes[n] + " has sent no record about variable " + variables[v]); return; }
      const state = row => row.number === DELETED ? "deletes variable " + variables[v] : row.number === ASKED ? "requests variable " + variables[v] : "states " + row.number + " of variable " + variables[v];
      for (let hops = 0; place >= 0 && hops < 64; hops++) {
        const row = rows[place];
        const from = row.source >= 0 ? "; frame " + row.by + " of " + nodes[rows[row.source].n] + " is the last one with it before" : "";
        const asks = row.asked && hops === 0 ? "; it requests the value " + row.asked + " times" : "";
        line("+" + seconds(row.t) + " s, frame " + row.frame + ": " + nodes[row.n] + " " + state(row) + from + asks);
        place = row.source;
      }
    };
    for (const [key, cell] of cells) cell.addEventListener("click", () => tell(key));
    at.max = times.length - 1; at.value = at.max;
    at.addEventListener("input", draw);
    document.querySelector("#holds-before").addEventListener("click", jump(-1));
    document.querySelector("#holds-next").addEventListener("click", jump(1));
    draw();
  }
})();
