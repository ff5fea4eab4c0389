"use strict";
// A heading sorts its table: numbers by value, words by letters; once more turns the order round.
for (const table of document.querySelectorAll("table")) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, place) => heading.querySelector("button").addEventListener("click", () => {
    const down = heading.getAttribute("aria-sort") === "ascending";
    headings.forEach((other) => other.removeAttribute("aria-sort"));
    heading.setAttribute("aria-sort", down ? "descending" : "ascending");
    const value = (row) => row.cells[place].dataset.value ?? row.cells[place].textContent;
    const number = (text) => (text === "" ? NaN : Number(text));
    const compare = (a, b) => {
      const [left, right] = [value(a), value(b)];
      if (!heading.classList.contains("number")) return left.localeCompare(right, undefined, { numeric: true });
      const [x, y] = [number(left), number(right)];
      if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
      return x === y ? 0 : x - y;
    };
    const empty = (row) => heading.classList.contains("number") && Number.isNaN(number(value(row)));
    const rows = [...table.tBodies[0].rows].sort((a, b) => (down && !empty(a) && !empty(b) ? compare(b, a) : compare(a, b)));
    table.tBodies[0].append(...rows);
  }));
}
// A file has no clipboard in every browser: where it has none, the text is selected instead.
for (const button of document.querySelectorAll("[data-copies]")) {
  button.addEventListener("click", async () => {
    const source = document.getElementById(button.dataset.copies);
    try {
      await navigator.clipboard.writeText(source.textContent);
      button.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(source);
      button.textContent = "Selected";
    }
    document.getElementById("said").textContent = button.textContent;
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });
}
