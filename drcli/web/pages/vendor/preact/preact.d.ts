// What the pages use of the bundle, for the check of types.
type Hook = (...values: any[]) => any;
export interface Signal<T> {
  value: T;
}
export class Component {
  setState(state: any): void;
}
export const Fragment: any;
export function createContext<T>(value: T): { Provider: any; value: T };
export function render(what: any, where: Element): void;
export function html(texts: TemplateStringsArray, ...values: any[]): any;
export function signal<T>(value: T): Signal<T>;
export function computed<T>(compute: () => T): Signal<T>;
export function effect(run: () => void): () => void;
export function batch(run: () => void): void;
export function untracked<T>(run: () => T): T;
export function useContext<T>(context: { value: T }): T;
export function useEffect(run: () => void | (() => void), values?: any[]): void;
export function useLayoutEffect(run: () => void | (() => void), values?: any[]): void;
export function useId(): string;
export function useMemo<T>(make: () => T, values: any[]): T;
export function useRef<T>(value: T): { current: T };
export function useState<T>(value: T | (() => T)): [T, (next: T | ((before: T) => T)) => void];
export const useComputed: Hook, useSignal: Hook, useSignalEffect: Hook;
