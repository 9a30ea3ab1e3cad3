import type { ComponentChildren } from "preact";

interface Props {
  children: ComponentChildren;
  /** Whether it is disabled. It can still be focused, so that the keyboard keeps its position. */
  off?: boolean;
  /** Undefined for a button that submits its form. */
  press?: () => void;
  look?: string;
  label?: string;
  title?: string;
  pressed?: boolean;
  focus?: (element: HTMLButtonElement | null) => void;
}

export function Button({ children, off = false, press, look = "", label, title, pressed, focus }: Props) {
  return (
    <button
      ref={focus ?? null}
      type={press ? "button" : "submit"}
      class={look}
      aria-disabled={off}
      aria-label={label}
      aria-pressed={pressed}
      title={title}
      onClick={(event) => {
        if (off) event.preventDefault();
        else press?.();
      }}
    >
      {children}
    </button>
  );
}
