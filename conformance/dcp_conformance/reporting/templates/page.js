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
    // The states; times are in intervals of data.interval_ns. Each change of a state is a position of the slider.
    const rows = [], moments = new Set(); let clock = 0;
    for (const [step, n, v, number, frame, asked, source, by, count, left = -1, until = -1, stale = -1] of data.changes) {
      clock += step; moments.add(clock);
      rows.push({ t: clock, n, v, number, frame, asked, source, by, count, left, until, stale });
      if (stale >= 0) moments.add(stale);
    }
    moments.add(Math.floor((data.end_ns - data.begin_ns) / data.interval_ns));
    const times = [...moments].sort((a, b) => a - b);
    const seconds = t => (t * data.interval_ns / 1e9).toFixed(data.interval_ns < 1e7 ? 3 : 1), short = t => (t * data.interval_ns / 1e9).toFixed(1);
    const replay = visit => {
      const held = new Map(), producer = new Map();
      let p = 0, i = 0;
      for (const t of times) {
        while (p < data.producers.length && data.producers[p][0] <= t) { producer.set(data.producers[p][1], data.producers[p][2]); p++; }
        for (; i < rows.length && rows[i].t <= t; i++) held.set(rows[i].v * nodes.length + rows[i].n, rows[i]);
        if (visit(t, held, producer) === false) return;
      }
    };
    // How far a state is behind that of the producer: values and time, as the ledger counts them.
    const lag = (row, t, held, producer) => {
      if (!row || row.left < 0 || row.left > t) return null;
      const own = held.get(row.v * nodes.length + producer.get(row.v));
      return { age: Math.max(Math.min(t, row.until) - row.left, 0), values: own && own.count >= row.count ? own.count - row.count : 0, deleted: own !== undefined && own.number === DELETED, stale: row.stale >= 0 && row.stale <= t };
    };
    const words = behind => [behind.values || !behind.deleted ? behind.values + (behind.values === 1 ? " value" : " values") + " behind" : "", behind.deleted ? "deleted by the producer" : ""].filter(Boolean).join(" and ") + ", for " + short(behind.age) + " s";
    const brief = behind => [behind.values || !behind.deleted ? "\u2212" + behind.values : "", behind.deleted ? "\u00d7" : ""].filter(Boolean).join(" ");
    const cells = new Map(), head = table.createTHead().insertRow(), body = table.createTBody();
    const heading = (row, text, scope, title) => { const th = document.createElement("th"); th.scope = scope; th.textContent = text; th.title = title; row.append(th); };
    heading(head, "variable", "col", "");
    for (const n of columns) heading(head, nodes[n].slice(-5), "col", nodes[n]);
    for (const v of order) {
      const row = body.insertRow(); heading(row, variables[v], "row", "variable " + variables[v]);
      for (const n of columns) cells.set(v * nodes.length + n, row.insertCell());
    }
    // Number of stale states at each moment. A state is stale until the node's next state of the variable.
    const stale = []; const last = new Map(), open = new Set(); let place = 0;
    replay((t, held) => {
      for (const [key, row] of held) if (last.get(key) !== row) { last.set(key, row); open.delete(key); if (row.stale >= 0) open.add(key); }
      stale[place++] = [...open].filter(key => held.get(key).stale <= t).length;
    });
    const draw = () => {
      const goal = times[at.value];
      replay((t, held, producer) => {
        if (t < goal) return true;
        let worst = null, late = 0, bad = 0;
        for (const [key, cell] of cells) {
          const row = held.get(key), behind = lag(row, t, held, producer), own = producer.get(Math.floor(key / nodes.length)) === key % nodes.length;
          cell.textContent = row === undefined ? "" : row.number === DELETED ? "\u00d7" : row.number === ASKED ? "?" : String(row.number);
          cell.className = own ? "own" : "";
          cell.title = behind ? words(behind) : "";
          if (!behind) continue;
          cell.className = behind.stale ? "bad" : "late";
          if (!behind.stale) { late++; cell.textContent += " " + brief(behind); continue; }
          bad++;
          if (!worst || behind.age > worst.age) worst = behind;
          const small = document.createElement("small");
          small.textContent = brief(behind) + ", " + short(behind.age) + " s";
          cell.append(small);
        }
        const many = (count, text) => count + (count === 1 ? " state is " : " states are ") + text;
        let text = bad ? many(bad, "stale") + (bad === 1 ? ": " : ", the oldest ") + words(worst) : "no state is stale";
        if (late) text += "; " + many(late, "behind for a shorter time");
        when.textContent = "+" + seconds(t) + " s: " + text;
        return false;
      });
    };
    const jump = step => () => {
      let i = Number(at.value) + step;
      while (i > 0 && i < times.length - 1 && !stale[i]) i += step;
      at.value = Math.min(Math.max(i, 0), times.length - 1); draw();
    };
    for (const button of document.querySelectorAll("button[data-second]")) button.addEventListener("click", () => {
      const goal = Math.ceil((button.dataset.second * 1e9 + data.patience_ns) / data.interval_ns);
      at.value = Math.max(times.findIndex(t => t >= goal), 0); draw(); at.scrollIntoView({ block: "center" });
    });
    // A click on a cell tells how its value came there; a row of changes names the row that it came from.
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
    // Begin at the last moment with the most stale states; at the end if there are none.
    at.max = times.length - 1;
    const most = stale.reduce((a, b) => Math.max(a, b), 0);
    at.value = stale.lastIndexOf(most);
    at.addEventListener("input", draw);
    for (const [id, step] of [["#holds-before", -1], ["#holds-next", 1]]) {
      const button = document.querySelector(id);
      button.hidden = most === 0; button.addEventListener("click", jump(step));
    }
    draw();
  }
})();
