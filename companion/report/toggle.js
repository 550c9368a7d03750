for (const box of document.querySelectorAll(".key input")) {
  const apply = () => {
    for (const part of document.querySelectorAll(".series-" + box.value)) part.classList.toggle("off", !box.checked);
  };
  box.addEventListener("change", apply);
  apply();
}
