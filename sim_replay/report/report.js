'use strict';
// Without this script the page can be read; with it the table sorts and filters, and the map moves.
(function () {
  const $ = (selector, within) => (within || document).querySelector(selector);
  const all = (selector, within) => Array.from((within || document).querySelectorAll(selector));
  document.documentElement.classList.add('scripted');

  // A link to a contact or a strip opens what it lies in.
  const reveal = () => {
    let target = null;
    try { target = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1))); } catch (error) { return; }
    if (!target) return;
    for (let part = target.closest('details'); part; part = part.parentElement.closest('details')) part.open = true;
    if (target.hidden) { form.reset(); ungroup(); }
    target.scrollIntoView();
  };
  addEventListener('hashchange', reveal);

  // Table
  const rows = all('#table tbody tr');
  const form = $('#filter');
  const marks = new Map(all('.chart a[data-id]').map((mark) => [mark.dataset.id, mark]));
  const filter = () => {
    if (!form) return;
    const words = form.words.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
    const least = Number(form.least.value), kind = form.kind.value, called = form.called.checked;
    const grouped = form.grouped ? form.grouped.checked : false;
    const verdict = form.verdict ? form.verdict.value : '';
    $('#least-shown').textContent = Math.round(100 * least) + ' %';
    let n = 0;
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      const shown = Number(row.dataset.p) >= least && (!kind || row.dataset.kind === kind)
        && (!called || row.dataset.called === 'yes') && (!grouped || !row.dataset.grouped)
        && (!verdict || (verdict === 'judged' ? row.dataset.verdict !== 'none' : row.dataset.verdict === verdict)) && words.every((word) => text.includes(word));
      row.hidden = !shown;
      const mark = marks.get(row.dataset.id);
      if (mark) mark.classList.toggle('out', !shown);
      n += shown;
    }
    $('#shown').textContent = n + ' of ' + rows.length;
  };
  const ungroup = () => {
    if (form.grouped) form.grouped.checked = false;
    filter();
  };
  if (form) {
    form.hidden = false;
    form.addEventListener('input', filter);
    form.addEventListener('reset', () => setTimeout(ungroup));
    form.addEventListener('submit', (event) => event.preventDefault());
    filter();
  }
  for (const head of all('#table th[data-sort]')) {
    const button = document.createElement('button');
    button.type = 'button';
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener('click', () => {
      const rising = head.getAttribute('aria-sort') ? head.getAttribute('aria-sort') === 'descending' : head.dataset.sort === 'text';
      for (const other of all('#table th')) other.removeAttribute('aria-sort');
      head.setAttribute('aria-sort', rising ? 'ascending' : 'descending');
      const column = head.cellIndex, number = head.dataset.sort === 'number';
      const value = (row) => {
        const cell = row.cells[column], text = cell.dataset.v === undefined ? cell.textContent : cell.dataset.v;
        return number ? (text === '' ? NaN : Number(text)) : text;
      };
      const order = (a, b) => {
        const [x, y] = [value(a), value(b)];
        if (number && (isNaN(x) || isNaN(y))) return isNaN(x) - isNaN(y); // what is not known comes last
        const by = number ? x - y : x.localeCompare(y, 'en', {numeric: true});
        return (rising ? by : -by) || a.dataset.id.localeCompare(b.dataset.id, 'en', {numeric: true});
      };
      rows.sort(order);
      $('#table tbody').append(...rows);
    });
  }

  // Map
  const chart = $('.chart');
  if (chart) {
    const whole = chart.viewBox.baseVal, width = whole.width, height = whole.height;
    let view = {x: 0, y: 0, zoom: 1};
    const show = () => {
      view.zoom = Math.min(Math.max(view.zoom, 1), 64);
      view.x = Math.min(Math.max(view.x, 0), width - width / view.zoom);
      view.y = Math.min(Math.max(view.y, 0), height - height / view.zoom);
      chart.setAttribute('viewBox', [view.x, view.y, width / view.zoom, height / view.zoom].join(' '));
      chart.style.setProperty('--zoom', view.zoom);
      $('#map-back').disabled = view.zoom === 1;
    };
    const place = (event) => {
      const frame = chart.getBoundingClientRect();
      return [view.x + (event.clientX - frame.left) / frame.width * width / view.zoom,
        view.y + (event.clientY - frame.top) / frame.height * height / view.zoom];
    };
    const zoom = (factor, at) => {
      const [x, y] = at || [view.x + width / 2 / view.zoom, view.y + height / 2 / view.zoom];
      const before = view.zoom;
      view.zoom = Math.min(Math.max(view.zoom * factor, 1), 64);
      view.x = x - (x - view.x) * before / view.zoom;
      view.y = y - (y - view.y) * before / view.zoom;
      show();
    };
    const corners = JSON.parse(chart.dataset.corners);
    const chartWords = (degrees, positive, negative) => {
      const minutes = Math.round(Math.abs(degrees) * 60e4) / 1e4;
      return Math.floor(minutes / 60) + '° ' + (minutes % 60).toFixed(4).padStart(7, '0') + '′ ' + (degrees < 0 ? negative : positive);
    };
    const cursor = (event) => {
      const [x, y] = place(event), right = x / width, down = y / height;
      const [[lat0, lon0], [lat1, lon1], [lat2, lon2]] = corners;
      const apart = (degrees) => (degrees + 540) % 360 - 180;
      const lat = lat0 + right * (lat1 - lat0) + down * (lat2 - lat0);
      const lon = apart(lon0 + right * apart(lon1 - lon0) + down * apart(lon2 - lon0));
      $('#cursor').textContent = chartWords(lat, 'N', 'S') + ', ' + chartWords(lon, 'E', 'W');
    };
    const pointers = new Map();
    let moved = 0;
    chart.addEventListener('wheel', (event) => {
      if (!(event.ctrlKey || event.metaKey || document.activeElement === chart || view.zoom > 1)) return;
      if (view.zoom === 1 && event.deltaY > 0) return; // the page scrolls on
      event.preventDefault();
      zoom(Math.exp(-event.deltaY / 400), place(event));
    }, {passive: false});
    chart.addEventListener('pointerdown', (event) => { pointers.set(event.pointerId, event); moved = 0; });
    addEventListener('pointerup', (event) => pointers.delete(event.pointerId));
    addEventListener('pointercancel', (event) => pointers.delete(event.pointerId));
    chart.addEventListener('pointermove', (event) => {
      cursor(event);
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const frame = chart.getBoundingClientRect(), unit = width / view.zoom / frame.width;
      const others = Array.from(pointers.values()).filter((one) => one.pointerId !== event.pointerId);
      if (others.length) {
        const apart = (one) => Math.hypot(one.clientX - others[0].clientX, one.clientY - others[0].clientY);
        zoom(apart(event) / Math.max(apart(before), 1), place(others[0]));
      } else if (event.pointerType === 'mouse' || view.zoom > 1) {
        view.x -= (event.clientX - before.clientX) * unit;
        view.y -= (event.clientY - before.clientY) * unit;
        show();
      }
      moved += Math.hypot(event.clientX - before.clientX, event.clientY - before.clientY);
      pointers.set(event.pointerId, event);
    });
    chart.addEventListener('click', (event) => { if (moved > 4) event.preventDefault(); }, true);
    chart.addEventListener('dragstart', (event) => event.preventDefault());
    chart.addEventListener('dblclick', (event) => zoom(2, place(event)));
    chart.addEventListener('keydown', (event) => {
      const step = 60 / view.zoom;
      const moves = {ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step]};
      if (event.key === '+' || event.key === '=') zoom(1.5);
      else if (event.key === '-') zoom(1 / 1.5);
      else if (event.key === '0') zoom(0);
      else if (moves[event.key] && view.zoom > 1) { view.x += moves[event.key][0]; view.y += moves[event.key][1]; show(); }
      else return;
      event.preventDefault();
    });
    $('#map-in').addEventListener('click', () => zoom(1.5));
    $('#map-out').addEventListener('click', () => zoom(1 / 1.5));
    $('#map-back').addEventListener('click', () => zoom(0));
    for (const box of all('#layers input')) {
      const set = () => chart.classList.toggle('no-' + box.name, !box.checked);
      box.addEventListener('input', set);
      set();
    }
    chart.tabIndex = 0;
    $('#map-tools').hidden = false;
    show();
    for (const link of all('a[data-on-map]')) {
      link.hidden = false;
      link.addEventListener('click', () => {
        const mark = marks.get(link.dataset.onMap);
        if (!mark) return;
        view.zoom = 8;
        view.x = Number(mark.dataset.x) - width / 16;
        view.y = Number(mark.dataset.y) - height / 16;
        show();
        for (const other of marks.values()) other.classList.toggle('found', other === mark);
      });
    }
  }
  reveal();
})();
