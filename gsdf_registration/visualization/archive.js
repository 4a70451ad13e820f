// Shows the results that contain a text, or only those that were not registered.
'use strict';
const words = document.getElementById('words');
const refused = document.getElementById('refused');

function choose() {
  const text = words.value.toLowerCase();
  let shown = 0;
  const rows = document.querySelectorAll('#all tbody tr');
  for (const row of rows) {
    row.hidden = !row.textContent.toLowerCase().includes(text)
      || (refused.checked && !row.querySelector('b.bad'));
    shown += !row.hidden;
  }
  document.getElementById('shown').textContent = shown < rows.length
    ? `${shown} of ${rows.length}` : '';
}

if (words) {
  words.addEventListener('input', choose);
  refused.addEventListener('change', choose);
}
