// Elements of the page: find one by its id, make one with a text.
export const $ = (id) => document.getElementById(id);

export function part(tag, text, name = "") {
  const element = document.createElement(tag);
  element.textContent = text;
  if (name) element.className = name;
  return element;
}
