"use strict";
// Opens a folded block that a link leads to; without it a click on its summary does.
(() => {
  const open = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (target instanceof HTMLDetailsElement) target.open = true;
  };
  window.addEventListener("hashchange", open);
  open();
})();

// Shows the figures of one data set and protocol; without it all are small multiples.
for (const choices of document.querySelectorAll(".choices")) {
  const selects = [...choices.querySelectorAll("select")];
  const figures = [...choices.parentElement.querySelectorAll("figure.one-case")];
  const show = () => {
    for (const figure of figures) {
      figure.hidden = selects.some(
        ({ value, dataset }) => value !== "" && figure.dataset[dataset.kind] !== value,
      );
    }
  };
  for (const select of selects) select.addEventListener("change", show);
  choices.hidden = false;
  show();
}

// Sorts and filters the tables that are in the page already; without it they stay readable.
(() => {
  const ROWS_A_PAGE = 25;

  const missingLast = (sign) => (a, b) => {
    if (a === "" || b === "") return Number(a === "") - Number(b === "");
    return sign * (Number(a) - Number(b));
  };
  DataTable.type("measured", { order: { asc: missingLast(1), desc: missingLast(-1) } });

  // "< 0.1" and "> 3" ask for numbers, all else for a part of the text
  const passes = (asked, text, order) => {
    const bound = /^\s*([<>])\s*([-+]?[\d.]+(?:e[-+]?\d+)?)\s*$/i.exec(asked);
    if (bound === null) return text.toLowerCase().includes(asked.trim().toLowerCase());
    if (order === "") return false;
    return bound[1] === "<" ? Number(order) < Number(bound[2]) : Number(order) > Number(bound[2]);
  };

  const addFilters = (table, element, headings) => {
    const row = element.tHead.insertRow();
    row.className = "filters";
    headings.forEach((heading, column) => {
      const field = document.createElement("input");
      field.type = "search";
      field.setAttribute("aria-label", `Filter ${heading}`);
      field.placeholder = "filter";
      field.addEventListener("input", () => {
        const asked = field.value;
        table.column(column).search.fixed("field", (text, data, index) => {
          const cell = table.cell(index, column).node();
          return passes(asked, cell.textContent, cell.dataset.order);
        });
        table.draw();
      });
      row.insertCell().append(field);
    });
  };

  const tables = [];
  for (const element of document.querySelectorAll("table.widget")) {
    const cells = [...element.tHead.rows[0].cells];
    const headings = cells.map((cell) => cell.textContent);
    const long = element.tBodies[0].rows.length > ROWS_A_PAGE;
    const box = element.closest(".scroll");
    const table = new DataTable(element, {
      autoWidth: false,
      order: [],
      paging: long,
      pageLength: ROWS_A_PAGE,
      lengthMenu: [ROWS_A_PAGE, 100, { label: "all", value: -1 }],
      layout: {
        topStart: long ? "pageLength" : null,
        topEnd: "search",
        bottomStart: "info",
        bottomEnd: long ? "paging" : null,
      },
      columnDefs: cells.map((cell, targets) => ({
        targets,
        type: cell.classList.contains("number") ? "measured" : "string",
      })),
    });
    const title = element.caption.textContent;
    const namePages = () => {
      const pages = element.closest(".dt-container")?.querySelector(".dt-paging nav");
      pages?.setAttribute("aria-label", `Pages of: ${title}`);
    };
    table.on("draw", namePages);
    namePages();
    addFilters(table, element, headings);
    // the table alone scrolls sideways, not the fields around it
    const inner = element.closest(".dt-layout-table");
    for (const name of ["tabindex", "role", "aria-labelledby"]) {
      inner.setAttribute(name, box.getAttribute(name));
      box.removeAttribute(name);
    }
    box.classList.remove("scroll");
    inner.classList.add("scroll");
    tables.push(table);
  }
  for (const text of document.querySelectorAll(".with-scripts")) text.hidden = tables.length === 0;

  // paper has no next page to click for; afterwards the screen is as it was
  const lengths = new Map();
  window.addEventListener("beforeprint", () => {
    for (const table of tables) {
      if (!lengths.has(table)) lengths.set(table, [table.page.len(), table.page()]);
      table.page.len(-1).draw();
    }
  });
  window.addEventListener("afterprint", () => {
    for (const [table, [length, page]] of lengths) {
      table.page.len(length).page(page).draw("page");
    }
    lengths.clear();
  });
})();
